from collections.abc import Sequence

import numpy as np
import pytest

from spikingtac.contact.event_count import QUIET_WINDOWS, RELEASE_WINDOWS, SelfCalibratingDetector
from spikingtac.contact.quiet import unsettled
from spikingtac.types import EventPacket

# Events per ms on a simulated typical camera: at rest, in a slow slide, while pressing.
QUIET_COUNT, SLIDE_COUNT, PRESS_COUNT = 18, 46, 120


def begun_at(counts: list[int], before: Sequence[int] = ()) -> list[int]:
    """Return the windows in which contacts begin, after some windows and then quiet ones."""
    detector, found = SelfCalibratingDetector(), []
    rng = np.random.default_rng(0)
    for index, mean in enumerate([*before, *[QUIET_COUNT] * QUIET_WINDOWS, *counts]):
        n = int(rng.poisson(mean)) if mean == QUIET_COUNT else mean
        zero = np.zeros(n, np.uint16)
        t_us = np.full(n, index * 1_000, np.int64)
        window = EventPacket(
            zero, zero, zero.astype(bool), t_us, index * 1_000, index * 1_000 + 1_000, (4, 4)
        )
        if detector.update(window) is not None:
            found.append(index - QUIET_WINDOWS - len(before))
    return found


def test_a_contact_that_slides_slowly_is_one_contact() -> None:
    slide = [PRESS_COUNT] * 200 + [SLIDE_COUNT] * 1_000 + [PRESS_COUNT] * 200
    assert begun_at([QUIET_COUNT] * 100 + slide) == [100]


def test_a_finger_that_left_and_comes_back_is_two_contacts() -> None:
    pause = [QUIET_COUNT] * (RELEASE_WINDOWS + 100)
    press = [PRESS_COUNT] * 200
    assert begun_at(press + pause + press) == [0, 200 + len(pause)]


def test_quiet_windows_and_weak_ones_begin_nothing() -> None:
    assert begun_at([QUIET_COUNT] * 5_000 + [SLIDE_COUNT] * 100) == []


@pytest.mark.parametrize("before", [[900] * 40, [5000], [0] * 120, [0] * 60 + [700] * 20])
def test_a_burst_or_silence_at_the_start_teaches_nothing(before: list[int]) -> None:
    press = [QUIET_COUNT] * 200 + [PRESS_COUNT] * 200
    assert begun_at(press, before) == [200]
    assert begun_at([QUIET_COUNT] * 5_000, before) == []


def test_a_sensor_without_noise_is_not_unsettled() -> None:
    assert unsettled(np.zeros(300, np.int64)) == 0
    assert unsettled(np.array([0] * 200 + [0, 40, 90] * 33 + [0])) == 0
    assert unsettled(np.array([500] * 45 + [3] * 255)) == 60
