"""Where bytes were lost, the word boundaries are found again; where words are odd, they stay."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.events.evt.salvage import aligned

WORD = np.dtype("<u2")
SOUND_WORDS = 40


def sound_bytes(words: int) -> np.ndarray:
    return np.arange(2 * words, dtype=np.uint8)


def suspects_of(length: int, boundary: int, later_boundary: int) -> np.ndarray:
    """Doubt every second word that begins elsewhere: half of random words look plausible."""
    offset = np.arange(length - 1)
    origin = np.where(offset < boundary, 0, later_boundary)
    misplaced = (offset - origin) % 2 == 1
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


@pytest.mark.parametrize("odd", [1, 3])
def test_a_few_odd_words_are_no_break(odd: int) -> None:
    data = sound_bytes(SOUND_WORDS)
    suspects = np.zeros(len(data) - 1, np.bool_)
    suspects[20 : 20 + 2 * odd : 2] = True
    words, _, breaks = aligned(data, suspects, WORD)
    assert breaks == 0
    np.testing.assert_array_equal(words, data.view(WORD))
