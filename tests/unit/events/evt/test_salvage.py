"""Damaged RAW: word boundaries are found again, and stretches of fill invent nothing."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import DamageError
from spikingtac.events import open_events
from spikingtac.events.evt.salvage import aligned, may_be_filled, without_fill
from spikingtac.types import EventPacket
from stand_ins.random_packets import packet_of, random_packet, rows, save_events

WORD = np.dtype("<u2")
SOUND_WORDS = 40


def sound_bytes(words: int) -> np.ndarray:
    return np.arange(2 * words, dtype=np.uint8)


def suspects_of(length: int, boundary: int, later_boundary: int) -> np.ndarray:
    """Doubt every second word that begins elsewhere: half of random words look plausible."""
    offset = np.arange(length - 1)
    misplaced = (offset - np.where(offset < boundary, 0, later_boundary)) % 2 == 1
    return misplaced & (offset // 2 % 2 == 0)


@pytest.mark.parametrize("words_after", [12, 60])
def test_a_lost_byte_is_noticed_within_a_dozen_words(words_after: int) -> None:
    data = np.delete(sound_bytes(SOUND_WORDS + 1 + words_after), 2 * SOUND_WORDS)
    suspects = suspects_of(len(data), 2 * SOUND_WORDS, 2 * SOUND_WORDS + 1)
    words, end, breaks = aligned(data, suspects, WORD)
    assert (breaks, end) == (1, len(data))
    # Half of the misplaced words look sound, so that the break is known to a few words.
    sure = slice(0, SOUND_WORDS - 4)
    np.testing.assert_array_equal(words[sure], sound_bytes(SOUND_WORDS).view(WORD)[sure])
    np.testing.assert_array_equal(words[-8:], data[-16:].view(WORD))


SIZE = (320, 320)
LOST_BYTES = 8_192


@cache
def sample() -> EventPacket:
    events = random_packet(0, 60_000, (319, 319), 4)
    return packet_of(events.t, events.x + 1, events.y + 1, events.p, SIZE)


@pytest.mark.parametrize("encoding", ["evt2", "evt21", "evt3"])
@pytest.mark.parametrize("fill", [0x00, 0xFF])
@pytest.mark.parametrize("place", [20_000, 262_144 - 4_000, 262_144 + 100 - LOST_BYTES])
def test_lost_sectors_are_counted_and_invent_nothing(
    tmp_path: Path, encoding: str, fill: int, place: int
) -> None:
    path = save_events(tmp_path / "a.raw", sample(), encoding=encoding)
    data = bytearray(path.read_bytes())
    place = min(place, len(data) - 2 * LOST_BYTES)
    data[place : place + LOST_BYTES] = bytes([fill]) * LOST_BYTES
    path.write_bytes(data)
    source = open_events(path)
    found = EventPacket.concatenate(list(source))
    assert source.losses["garbage"] == 1
    assert not ((found.x == 0) & (found.y == 0)).any()
    # Times and rows of the words after the hole are those before it.
    assert len({*rows(found)} - {*rows(sample())}) <= 130
    assert len(found) > len(sample()) - LOST_BYTES // 2 - 200
    with pytest.raises(DamageError, match="garbage"):
        list(open_events(path, strict=True))


def test_fill_is_found_whatever_its_place() -> None:
    rng = np.random.default_rng(1)
    for start in range(0, 48):
        data = rng.integers(1, 255, 300).astype(np.uint8)
        data[start : start + 64] = 0
        assert may_be_filled(data)
        kept, begun, goes_on = without_fill(data.view(np.uint32), False)
        whole = start % 4 == 0
        assert (len(kept), begun, goes_on) == (75 - 16 * whole, int(whole), False)
    assert not may_be_filled(rng.integers(1, 255, 1_000).astype(np.uint8))
