"""Windows of two sensors on one clock stay paired by time."""

from collections.abc import Iterator

import numpy as np
import pytest

from spikingtac.contact import come_in_bursts
from spikingtac.contact.detector import WINDOW_US
from spikingtac.contact.recording import _aligned, find_contacts, leading_quiet, quietest
from spikingtac.contact.registry import EventCountDetector
from spikingtac.types import EventPacket
from stand_ins.random_packets import packet_of

SIZE = (8, 8)


def window(number: int, off: int = 1, on: int = 0) -> EventPacket:
    start_us = number * WINDOW_US
    t, p = np.full(off + on, start_us), np.arange(off + on) >= off
    return packet_of(t, 0 * t, 0 * t, p, SIZE, (start_us, start_us + WINDOW_US))


def windows(*numbers: int) -> Iterator[EventPacket]:
    """Yield windows of one event each."""
    yield from map(window, numbers)


def rows(*streams: Iterator[EventPacket]) -> list[tuple[int, tuple[int, ...]]]:
    """Return each row's window number and the events of its sensors."""
    found = []
    for row in _aligned(streams):
        (start_us,) = {packet.t_start_us for packet in row}
        assert {packet.t_end_us for packet in row} == {start_us + WINDOW_US}
        found.append((start_us // WINDOW_US, tuple(len(packet) for packet in row)))
    return found


def test_a_sensor_whose_silence_was_not_filled_stays_paired() -> None:
    expected = [(0, (1, 1)), (1, (1, 0)), (2, (1, 0)), (3, (1, 1)), (4, (1, 1))]
    assert rows(windows(0, 1, 2, 3, 4), windows(0, 3, 4)) == expected


def test_pairs_end_with_the_shorter_sensor() -> None:
    assert rows(windows(0, 1, 2), windows(0, 1)) == [(0, (1, 1)), (1, (1, 1))]
    assert rows(windows(0, 5)) == [(0, (1,)), (5, (1,))]


def test_a_burst_at_the_start_is_neither_learned_nor_a_contact() -> None:
    counts = [400] * 40 + [3, 5, 4] * 200 + [90] * 20
    source = [window(number, count) for number, count in enumerate(counts)]
    begin, end = leading_quiet([source])  # type: ignore[list-item]
    assert begin == 60
    assert 540 <= end <= 640
    (found,) = find_contacts([source], EventCountDetector(20), first=begin)  # type: ignore[list-item]
    assert found[0].t_us == 641 * WINDOW_US


# Light that grows for 0.3 s, and a contact from 0.48 s on; the quietest stretch of a recording.
LIGHT = leading_quiet, [0] * 480 + [5] * 30, [*range(300), *[0] * 180, *[5] * 30], (0, 420)
QUIETEST = quietest, [9] * 100 + [2, 1] * 150 + [9] * 200, [0] * 600, (100, 400)


@pytest.mark.parametrize(("stretch_of", "off", "on", "stretch"), [LIGHT, QUIETEST])
def test_the_quiet_stretch(stretch_of, off, on, stretch):
    assert stretch_of([list(map(window, range(len(off)), off, on))]) == stretch


def test_a_press_in_quiet_windows_is_told_from_batches_and_vibration() -> None:
    batches, shaken = [0, 0, 0, 0, 9] * 100, [*[2] * 33, *[9] * 33] * 8
    for counts, pressed in (batches, False), (shaken, False), ([1] * 450 + [90] * 50, True):
        assert come_in_bursts(counts[:500]) == pressed
