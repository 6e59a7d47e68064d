"""EVT 2.0: 32-bit words, one event each; the upper 28 bits of the time come in words of their own.

Source: Prophesee, "EVT 2.0 Format" (public documentation). Counted from the top, an event's word
holds its type (4 bits: 0 OFF, 1 ON), the lower time (6), the column (11) and the row (11). Other
types: 8 upper time, 10 trigger, 13 to 15 vendor extensions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.evt.decoder import (
    BACKWARDS,
    BASE,
    HEIGHT,
    HIGH,
    MISSING,
    NOW,
    OUTSIDE,
    PADDINGS,
    TRIGGERS,
    UNKNOWN,
    VENDOR,
    WIDTH,
    Columns,
    Integer,
    TimeWords,
    WordDecoder,
    read_only,
    time_high_kernel,
    time_low_kernel,
)

EVENT_OFF, EVENT_ON, TIME_HIGH, TRIGGER = 0x0, 0x1, 0x8, 0xA
IMU, OTHERS, CONTINUED = 0xD, 0xE, 0xF
PADDING = 0x99999999
TIME_LOW_BITS, TIME_HIGH_BITS = 6, 28
SILENCE_STEP = 1 << 10
"""Upper times that one time word stands for in silence, so that there is one in 65,536 us."""

FAR_STEPS = 60_000_000 >> TIME_LOW_BITS
"""Distance of an upper time from the chunk's that is odd: a minute."""

UNKNOWN_TYPES = 0xFFFF & ~(1 << 0 | 1 << 1 | 1 << 8 | 1 << 10 | 1 << 13 | 1 << 14 | 1 << 15)
"""Types that the format does not define, as a bit set."""


class Evt2Decoder(WordDecoder):
    """Turns EVT2 words into events; keeps the upper time from call to call."""

    name = "evt2"
    word = np.dtype("<u4")
    events_per_word = 1
    low_bits = TIME_LOW_BITS
    high_bits = TIME_HIGH_BITS

    def decode(self, words: NDArray[Any], out: Columns) -> int:
        """Decode words into the columns and return the number of events."""
        return decode_kernel(read_only(words), *out, self.state)

    def suspects(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a suspicion for each byte offset: 0 none, 1 odd, 2 unknown type."""
        out = np.empty(max(len(data) - 3, 0), np.uint8)
        suspects_kernel(read_only(data), self.expected_high(data), out, self.state)
        return out

    def time_words(self, words: NDArray[Any]) -> TimeWords:
        """Return the upper times."""
        out = TimeWords.empty(len(words))
        return out.first(time_words_kernel(words, *out))

    def set_time_words(self, words: NDArray[Any], times: TimeWords) -> None:
        """Write mended upper times back into the words."""
        words[times.position] = (TIME_HIGH << 28) | times.value


@njit(cache=True, nogil=True)
def decode_kernel(
    words: NDArray[np.uint32],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    t: NDArray[np.int64],
    triggers: NDArray[np.int64],
    state: NDArray[np.int64],
) -> Any:
    """Decode words into the columns; return the number of events."""
    width, height = state[WIDTH], state[HEIGHT]
    n, base, now = 0, state[BASE], state[NOW]
    for i in range(len(words)):
        word = np.int64(words[i])
        kind = word >> 28
        if kind <= EVENT_ON:
            column, row = (word >> 11) & 0x7FF, word & 0x7FF
            if now >= 0 and column < width and row < height:
                wire = base + ((word >> 22) & 0x3F)
                if wire >= now:
                    now = wire
                else:
                    state[BACKWARDS] += 1
                x[n], y[n], p[n], t[n] = column, row, kind, now
                n += 1
            else:
                state[OUTSIDE if now >= 0 else MISSING] += 1
        else:
            state[NOW] = now
            if kind == TIME_HIGH:
                time_high_kernel(state, word & 0xFFFFFFF, TIME_LOW_BITS, TIME_HIGH_BITS, i)
            else:
                rare_kernel(word, PADDING, triggers, state)
            base, now = state[BASE], state[NOW]
    state[NOW] = now
    return n


@njit(cache=True, nogil=True)
def rare_kernel(
    word: Integer, padding: Integer, triggers: NDArray[np.int64], state: NDArray[np.int64]
) -> None:
    """Take a 32-bit word (of EVT2, or the upper half of one of EVT2.1) that is no event."""
    kind = word >> 28
    if kind == TRIGGER:
        if state[HIGH] >= 0:
            triggers[state[TRIGGERS], 0] = time_low_kernel(state, (word >> 22) & 0x3F)
            triggers[state[TRIGGERS], 1] = (word >> 8) & 0x1F
            triggers[state[TRIGGERS], 2] = word & 1
            state[TRIGGERS] += 1
    elif word == padding:
        state[PADDINGS] += 1
    elif (UNKNOWN_TYPES >> kind) & 1:
        state[UNKNOWN] += 1
    else:
        state[VENDOR] += 1


@njit(cache=True, nogil=True)
def suspects_kernel(
    data: NDArray[np.uint8], high: Integer, out: NDArray[np.uint8], state: NDArray[np.int64]
) -> None:
    """Mark for each byte offset what is wrong with the word that begins there."""
    for i in range(len(out)):
        word = np.int64(0)
        for k in range(4):
            word |= np.int64(data[i + k]) << (8 * k)
        out[i] = suspect_kernel(word, high, state)


@njit(cache=True, nogil=True)
def suspect_kernel(word: Integer, high: Integer, state: NDArray[np.int64]) -> Any:
    """Return 0 (fine), 1 (off the sensor, far in time, rare type) or 2 (unknown type) for a word.

    Args:
        word: A 32-bit word.
        high: The upper time that is expected about it.
        state: The decoder's state.
    """
    kind = word >> 28
    if (UNKNOWN_TYPES >> kind) & 1:
        return 0 if word == PADDING else 2
    if kind <= EVENT_ON:
        return 1 if (word >> 11) & 0x7FF >= state[WIDTH] or word & 0x7FF >= state[HEIGHT] else 0
    return 1 if kind != TIME_HIGH or abs((word & 0xFFFFFFF) - high) > FAR_STEPS else 0


@njit(cache=True, nogil=True)
def time_words_kernel(
    words: NDArray[np.uint32],
    position: NDArray[np.int64],
    value: NDArray[np.int64],
    wrapped: NDArray[np.bool_],
) -> Any:
    """Find the upper times, and whether the lower time fell from before to after each of them."""
    n, low, fresh = 0, 0, False
    for i in range(len(words)):
        kind = words[i] >> 28
        if kind == TIME_HIGH:
            position[n], value[n], wrapped[n] = i, words[i] & 0xFFFFFFF, False
            n, fresh = n + 1, True
        elif kind <= EVENT_ON:
            after = np.int64((words[i] >> 22) & 0x3F)
            if fresh and n:
                wrapped[n - 1] = after < low
            low, fresh = after, False
    return n
