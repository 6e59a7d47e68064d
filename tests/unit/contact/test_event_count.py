"""Count tests: the published threshold, its budget, and a threshold from a stream's beginning."""

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np
import pytest
from scipy import stats

from spikingtac.contact.detector import SECONDS_PER_HOUR, QuietStatistics, unsettled
from spikingtac.contact.registry import (
    QUIET_WINDOWS,
    RELEASE_WINDOWS,
    EventCountDetector,
    SelfCalibratingDetector,
)
from spikingtac.types import EventPacket
from stand_ins.random_packets import packet_at

WINDOWS, PERIOD_S = 10_000, 0.001

# Events per ms on a simulated typical camera: at rest, in a slow slide, while pressing.
QUIET_COUNT, SLIDE_COUNT, PRESS_COUNT = 18, 46, 120


def windows(counts: Iterable[int], first: int = 0) -> list[EventPacket]:
    begun_us = ((1_000 * k, count) for k, count in enumerate(counts, first))
    return [packet_at([t_us] * count, (t_us, t_us + 1_000), (320, 320)) for t_us, count in begun_us]


def test_the_first_window_above_the_threshold_is_the_contact() -> None:
    detector = EventCountDetector(5, release_windows=3)
    found = [detector.update(window) for window in windows([0, 5, 6, 9, 2, 7, 0, 0, 0, 8])]
    assert [contact and contact.t_us for contact in found] == [
        None, None, 3000, None, None, None, None, None, None, 10_000,
    ]  # fmt: skip
    assert found[2] is not None
    assert (found[2].count, found[2].threshold) == (6.0, 5)


@pytest.mark.parametrize("alarms_per_hour", [0.01, 1.0, 3_600.0])
def test_the_least_count_is_that_of_the_distribution(alarms_per_hour: float) -> None:
    chance = alarms_per_hour * PERIOD_S / SECONDS_PER_HOUR
    for mean, excess in product((0.02, 0.7, 3.0, 41.5, 2_000.0), (0.0, 0.3, 2.0, 40.0)):
        quiet = QuietStatistics(
            mean=mean, variance=mean * (1.0 + excess), highest=0, windows=WINDOWS, period_s=PERIOD_S
        )
        size = mean / excess if excess else np.inf
        law = stats.nbinom(size, size / (size + mean)) if excess else stats.poisson(mean)
        assert quiet.threshold(alarms_per_hour) == int(law.isf(chance))


def begun_at(counts: list[int], before: Sequence[int] = ()) -> list[int]:
    """Return the windows in which contacts begin, after some windows and then quiet ones."""
    detector, found = SelfCalibratingDetector(), []
    rng = np.random.default_rng(0)
    for index, mean in enumerate([*before, *[QUIET_COUNT] * QUIET_WINDOWS, *counts]):
        n = int(rng.poisson(mean)) if mean == QUIET_COUNT else mean
        (window,) = windows([n], index)
        if detector.update(window) is not None:
            found.append(index - QUIET_WINDOWS - len(before))
    return found


PRESS = [PRESS_COUNT] * 200
SLIDES = [QUIET_COUNT] * 100 + PRESS + [SLIDE_COUNT] * 1_000 + PRESS, [100]
RETURNS = PRESS + [QUIET_COUNT] * (RELEASE_WINDOWS + 100) + PRESS, [0, 300 + RELEASE_WINDOWS]
WEAK = [QUIET_COUNT] * 5_000 + [SLIDE_COUNT] * 100, []


@pytest.mark.parametrize(("counts", "begins"), [SLIDES, RETURNS, WEAK])
def test_one_contact_slides_two_return(counts: list[int], begins: list[int]) -> None:
    assert begun_at(counts) == begins


@pytest.mark.parametrize("before", [[900] * 40, [5000], [0] * 120, [0] * 60 + [700] * 20])
def test_a_burst_or_silence_at_the_start_teaches_nothing(before: list[int]) -> None:
    assert begun_at([QUIET_COUNT] * 200 + PRESS, before) == [200]
    assert begun_at([QUIET_COUNT] * 5_000, before) == []


def test_a_sensor_without_noise_is_not_unsettled() -> None:
    assert unsettled(np.zeros(300, np.int64)) == 0
    assert unsettled(np.array([0] * 200 + [0, 40, 90] * 33 + [0])) == 0
    assert unsettled(np.array([500] * 45 + [3] * 255)) == 60
