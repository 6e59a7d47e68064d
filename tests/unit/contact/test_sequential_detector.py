"""A contact's whole life: onset, place, direction, hold, end, and the next one."""

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


def test_details_tell_onset_place_and_direction(detector: SequentialMotionDetector) -> None:
    for window in windows(440, seed=6, speed=lambda k: (0.03 * (k >= 400), 0.03 * (k >= 400))):
        detector.update(window)
    details = detector.details()
    assert details is not None
    assert details.onset_us == pytest.approx(400_000, abs=3_000)
    (touch,) = details.touches
    assert touch is not None
    assert touch.markers == 9
    assert touch.place_px == pytest.approx((65.0, 65.0), abs=6.0)
    assert touch.push == pytest.approx((0.7, 0.7), abs=0.1)
    assert touch.turn == pytest.approx(0.0, abs=0.15)
