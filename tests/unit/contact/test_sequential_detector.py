"""A contact's whole life: begin, hold, end, and the next one."""

from collections.abc import Iterator

import pytest

from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.contact.sequential_detector import REST_WINDOWS, SequentialMotionDetector
from spikingtac.types import Contact, EventPacket
from stand_ins.moving_rims import calibration, windows


def press_and_back(window: int) -> tuple[float, float]:
    """Contacts of 0.15 s from 400 on and from 1000 on: 40 ms there, 40 ms back, 2 px."""
    for begin in (400, 1000):
        if begin <= window < begin + 40:
            return 0.05, 0.0
        if begin + 110 <= window < begin + 150:
            return -0.05, 0.0
    return 0.0, 0.0


@pytest.fixture(scope="module")
def built() -> SequentialMotionDetector:
    detector = make_detector("default", DetectionConfig(), [calibration()], windows(3000, seed=1))
    assert isinstance(detector, SequentialMotionDetector)
    return detector


@pytest.fixture
def detector(built: SequentialMotionDetector) -> SequentialMotionDetector:
    built.reset()
    return built


def course(
    detector: SequentialMotionDetector, stream: Iterator[EventPacket]
) -> tuple[list[Contact], list[int]]:
    contacts, ends = [], []
    for number, window in enumerate(stream):
        before = detector.in_contact
        contact = detector.update(window)
        if contact is not None:
            contacts.append(contact)
        if before and not detector.in_contact:
            ends.append(number)
    return contacts, ends


def test_two_contacts_begin_and_end(detector: SequentialMotionDetector) -> None:
    contacts, ends = course(detector, windows(1400, seed=2, speed=press_and_back))
    assert [contact.t_us // 1000 for contact in contacts] == pytest.approx([401, 1001], abs=3)
    rest = REST_WINDOWS
    assert ends == pytest.approx([550 + rest, 1150 + rest], abs=25)


def test_a_contact_that_is_held_goes_on_in_silence(detector: SequentialMotionDetector) -> None:
    hold = windows(4000, seed=3, speed=lambda k: (0.05 * (100 <= k < 140), 0.0))
    contacts, ends = course(detector, hold)
    assert len(contacts) == 1
    assert ends == []
    assert detector.in_contact


def test_a_vibration_is_no_contact_where_it_was_learned() -> None:
    def shake(window: int) -> tuple[float, float]:
        return (0.002 if window // 33 % 2 else -0.002), 0.0

    quiet = windows(3000, seed=4, speed=shake)
    detector = make_detector("default", DetectionConfig(), [calibration()], quiet)
    assert isinstance(detector, SequentialMotionDetector)
    assert course(detector, windows(3000, seed=5, speed=shake)) == ([], [])
