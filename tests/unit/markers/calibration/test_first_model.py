"""The event loss of a calibration's recording is measured, and told apart from noise."""

import numpy as np
import pytest

from spikingtac.markers.calibration.first_model import event_loss
from stand_ins.random_packets import decoded

PIXELS, INTERVALS, SWING = 2_000, 8, 7
INTERVAL_US = 1_000_000


@pytest.mark.parametrize(("lost", "noise"), [(0.0, 0), (0.0, 1), (0.3, 0), (0.3, 1), (0.5, 0)])
def test_lost_events_unbalance_a_pixel_and_noise_does_not(lost: float, noise: int) -> None:
    rng, pixel, codes = np.random.default_rng(1), np.arange(PIXELS), []
    for _ in range(INTERVALS):
        swings = np.concatenate([np.repeat(2 * pixel + on, SWING) for on in (1, 0)])
        by_chance = rng.integers(0, 2 * PIXELS, 2 * noise * PIXELS)
        both = np.concatenate([swings, by_chance])
        codes.append(both[rng.random(len(both)) >= lost].astype(np.uint32))
    index = np.cumsum([0, *map(len, codes)])
    time_us = np.linspace(0, INTERVALS * INTERVAL_US, index[-1])
    duration_us = INTERVALS * INTERVAL_US
    events = decoded(np.concatenate(codes), time_us, (PIXELS // 10, 10), duration_us)
    of_noise = np.full(2, noise * (1.0 - lost))
    assert event_loss(events, index, of_noise) == pytest.approx(lost, abs=0.03)
    assert event_loss(events, index[:5], of_noise) == 0.0, "four intervals are too few"
