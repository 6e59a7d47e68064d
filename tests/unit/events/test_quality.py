"""Noise, hot pixels and rates against the rates that the events were drawn with."""

import numpy as np
import pytest

from spikingtac.events.hot_pixels import judge_events
from spikingtac.types import EventPacket

SIZE = (120, 80)
DURATION_US = 4_000_000


def noisy(noise_hz: float, hot: tuple[tuple[int, int], ...], contact_us: int = 0) -> EventPacket:
    """Return noise, pixels that send at 200 Hz, and a dense contact of some length."""
    rng = np.random.default_rng(3)
    pixels = SIZE[0] * SIZE[1]
    count = rng.poisson(noise_hz * pixels * DURATION_US / 1e6)
    x, y = rng.integers(0, SIZE[0], count), rng.integers(0, SIZE[1], count)
    t = rng.integers(0, DURATION_US, count)
    for column, row in hot:
        many = rng.poisson(200.0 * DURATION_US / 1e6)
        x, y = np.append(x, np.full(many, column)), np.append(y, np.full(many, row))
        t = np.append(t, rng.integers(0, DURATION_US, many))
    touched = contact_us * 200  # 200 Mev/s over the whole sensor
    touched //= 1_000
    x = np.append(x, rng.integers(0, SIZE[0], touched))
    y = np.append(y, rng.integers(0, SIZE[1], touched))
    t = np.append(t, rng.integers(0, max(contact_us, 1), touched))
    order = np.argsort(t, kind="stable")
    p = rng.random(len(t)) < 0.25
    return EventPacket(
        x[order].astype(np.uint16), y[order].astype(np.uint16), p, t[order], 0, DURATION_US, SIZE
    )


@pytest.mark.parametrize("noise_hz", [0.5, 4.0])
def test_noise_and_hot_pixels_are_told_apart_beside_a_contact(noise_hz: float) -> None:
    hot = ((5, 7), (119, 79), (60, 0))
    found = judge_events(noisy(noise_hz, hot, contact_us=2_000_000))
    assert sorted(map(tuple, found.hot_px.tolist())) == sorted(hot)
    # The quietest tenth of the windows is quieter than the mean by the choice.
    assert found.noise_hz == pytest.approx(noise_hz, rel=0.3)
    assert found.on_fraction == pytest.approx(0.25, abs=0.01)
