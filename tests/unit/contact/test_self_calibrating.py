import numpy as np

from spikingtac.contact.self_calibrating import SelfCalibratingConfig, SelfCalibratingDetector
from spikingtac.types import EventPacket

CONFIG = SelfCalibratingConfig()

QUIET_COUNT, SLIDE_COUNT, PRESS_COUNT = 18, 46, 120
"""Events per ms on a simulated typical camera: at rest, in a slow slide, while pressing."""


def begun_at(counts: list[int]) -> list[int]:
    """Return the windows in which contacts begin, the first windows quiet before them."""
    detector, found = SelfCalibratingDetector(CONFIG), []
    rng = np.random.default_rng(0)
    for index, mean in enumerate([QUIET_COUNT] * CONFIG.quiet_windows + counts):
        n = int(rng.poisson(mean)) if mean == QUIET_COUNT else mean
        zero = np.zeros(n, np.uint16)
        t_us = np.full(n, index * 1_000, np.int64)
        window = EventPacket(
            zero, zero, zero.astype(bool), t_us, index * 1_000, index * 1_000 + 1_000, (4, 4)
        )
        if detector.update(window) is not None:
            found.append(index - CONFIG.quiet_windows)
    return found


def test_a_contact_that_slides_slowly_is_one_contact() -> None:
    slide = [PRESS_COUNT] * 200 + [SLIDE_COUNT] * 1_000 + [PRESS_COUNT] * 200
    assert begun_at([QUIET_COUNT] * 100 + slide) == [100]


def test_a_finger_that_left_and_comes_back_is_two_contacts() -> None:
    pause = [QUIET_COUNT] * (CONFIG.release_windows + 100)
    press = [PRESS_COUNT] * 200
    assert begun_at(press + pause + press) == [0, 200 + len(pause)]


def test_quiet_windows_and_weak_ones_begin_nothing() -> None:
    assert begun_at([QUIET_COUNT] * 5_000 + [SLIDE_COUNT] * 100) == []
