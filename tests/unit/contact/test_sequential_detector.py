"""A contact's whole life: begin, hold, end, and the next one."""

from collections.abc import Iterator

import numpy as np
import pytest

from spikingtac.contact.sequential_detector import REST_WINDOWS, SequentialMotionDetector
from spikingtac.types import Contact, EventPacket
from stand_ins.moving_rims import SIZE, calibration, windows
from stand_ins.random_packets import packet_of


def press_and_back(window: int) -> tuple[float, float]:
    """Contacts of 0.15 s from 400 on and from 1000 on: 40 ms there, 40 ms back, 2 px."""
    for begin in (400, 1000):
        if begin <= window < begin + 40:
            return 0.05, 0.0
        if begin + 110 <= window < begin + 150:
            return -0.05, 0.0
    return 0.0, 0.0


def learned(quiet: Iterator[EventPacket]) -> SequentialMotionDetector:
    return SequentialMotionDetector.from_quiet([calibration()], quiet, 1.0)


@pytest.fixture
def detector() -> SequentialMotionDetector:
    return learned(windows(3000, seed=1))


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


def test_a_contact_that_is_held_goes_on_in_silence(detector: SequentialMotionDetector) -> None:
    hold = windows(4000, seed=3, speed=lambda k: (0.05 * (100 <= k < 140), 0.0))
    contacts, ends = course(detector, hold)
    assert len(contacts) == 1
    assert ends == []
    assert detector.in_contact


def test_two_contacts_begin_and_end_of_which_one_circles(
    detector: SequentialMotionDetector,
) -> None:
    def circles(window: int) -> tuple[float, float]:
        turns = (window - 440) / 160
        if not 0.0 <= turns < 3.0:
            return press_and_back(window - 480 * (window >= 920))
        return -0.08 * np.sin(2.0 * np.pi * turns), 0.08 * np.cos(2.0 * np.pi * turns)

    contacts, ends = course(detector, windows(2000, seed=6, speed=circles))
    assert [contact.t_us // 1000 for contact in contacts] == pytest.approx([401, 1481], abs=3)
    assert ends == pytest.approx([1030 + REST_WINDOWS, 1630 + REST_WINDOWS], abs=25)


@pytest.mark.parametrize(("begin", "speed", "told_ms"), [(900, 0.1, 913), (700, 0.006, 918)])
def test_a_contact_ends_while_the_skin_creeps_back(
    detector: SequentialMotionDetector, begin: int, speed: float, told_ms: int
) -> None:
    """A quarter of a press of 4 px remains and creeps back; the next press is fast, or slow."""

    def press_and_creep(window: int) -> tuple[float, float]:
        if 400 <= window < 440:
            return 0.1, 0.0
        if 500 <= window < 530:
            return -0.1, 0.0
        if begin <= window < begin + 2.0 / speed:
            return speed, 0.0
        return (-0.0025 if 530 <= window < begin else 0.0), 0.0

    contacts, ends = course(detector, windows(1050, seed=6, speed=press_and_creep))
    assert [contact.t_us // 1000 for contact in contacts] == pytest.approx([401, told_ms], abs=5)
    assert ends == pytest.approx([530 + REST_WINDOWS], abs=20)


@pytest.mark.parametrize(("seed", "silent"), [(6, []), (11, []), (7, [0]), (7, [1])])
def test_single_events_of_a_silent_sensor_are_no_contact(seed: int, silent: list[int]) -> None:
    """Nor are the first ones of a polarity that was not seen before; a motion is."""
    quiet, rate = windows(600, seed, noise=0.1), 0.02 if silent else 0.1
    detector = learned(packet.select(~np.isin(packet.p, silent)) for packet in quiet)
    assert course(detector, windows(3000, 100 + seed, noise=rate)) == ([], [])
    contacts, _ = course(detector, windows(40, 9, lambda k: (0.05, 0.0), noise=rate))
    assert [contact.t_us // 1000 for contact in contacts] == [1]


def test_a_vibration_is_no_contact_where_it_was_learned() -> None:
    def shake(window: int) -> tuple[float, float]:
        return (0.002 if window // 33 % 2 else -0.002), 0.0

    detector = learned(windows(3000, seed=4, speed=shake))
    assert course(detector, windows(3000, seed=5, speed=shake)) == ([], [])


@pytest.mark.parametrize("brightens", [False, True])
def test_a_step_of_the_light_is_no_contact(
    detector: SequentialMotionDetector, brightens: bool
) -> None:
    stream = list(windows(500, 8, lambda k: (0.05 * (k >= 400), 0.0)))
    x, y = np.random.default_rng(1).integers(0, SIZE[0], (2, 3000))
    span_us = stream[100].t_start_us, stream[100].t_end_us
    step = packet_of(np.full(3000, span_us[0]), x, y, np.full(3000, brightens), SIZE, span_us)
    stream[100] = EventPacket.concatenate([step, stream[100]])
    contacts, _ = course(detector, iter(stream))
    assert [contact.t_us // 1000 for contact in contacts] == pytest.approx([401], abs=3)
