"""Windows of two sensors on one clock stay paired by time."""

from collections.abc import Iterator

from spikingtac.contact.detector import WINDOW_US
from spikingtac.contact.recording import _aligned, find_contacts, leading_quiet, quietest
from spikingtac.contact.registry import EventCountDetector
from spikingtac.types import EventPacket
from stand_ins.random_packets import packet_at

SIZE = (8, 8)


def window(number: int, events: int = 1) -> EventPacket:
    start_us = number * WINDOW_US
    return packet_at([start_us] * events, (start_us, start_us + WINDOW_US), SIZE)


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


def test_the_quietest_stretch_is_the_one_with_the_fewest_events() -> None:
    source = list(map(window, range(600), [9] * 100 + [2, 1] * 150 + [9] * 200))
    assert quietest([source]) == (100, 400)  # type: ignore[list-item]
