"""EVT 3.0: 16-bit words whose time, row and vector base are kept as state.

Source: Prophesee, "EVT 3.0 Format" (public documentation). A word's upper four bits are its type:
0 row, 2 single event, 3 vector base, 4 and 5 vectors of 12 and 8 pixels, 6 and 8 the lower and
upper 12 bits of the 24-bit time, 10 trigger, 7, 14 and 15 vendor extensions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.formats.clock import (
    EVENTS_BEFORE,
    HEIGHT,
    HIGH,
    MISSING,
    NO_ROW,
    NOW,
    OUTSIDE,
    PADDINGS,
    ROW,
    TRIGGERS,
    UNKNOWN,
    VECTOR_P,
    VECTOR_X,
    VENDOR,
    WIDTH,
    Integer,
    lone_low_kernel,
    time_high_kernel,
)
from spikingtac.events.formats.decoder import Columns, TimeWords, WordDecoder
from spikingtac.events.formats.salvage import mend_high_kernel

ADDR_Y, ADDR_X, BASE_X, VECT_12, VECT_8 = 0x0, 0x2, 0x3, 0x4, 0x5
TIME_LOW, CONTINUED_4, TIME_HIGH, TRIGGER, OTHERS, CONTINUED_12 = 0x6, 0x7, 0x8, 0xA, 0xE, 0xF
PADDING = 0x9999
"""Filler that some USB bridges send to complete a buffer."""

TIME_LOW_BITS = TIME_HIGH_BITS = 12
LOWEST_BIT = np.array([12] + [(mask & -mask).bit_length() - 1 for mask in range(1, 4096)], np.uint8)
"""Index of the lowest set bit of each 12-bit mask."""

VECTOR_WIDTH_PX = 32
"""Pixels that a base and its 12 + 12 + 8 vectors cover."""

VECTOR_WORDS = 3
REPEAT_BITS = 8
"""The upper time is repeated after 2^8 us, as sensors do: what is lost is found again sooner."""

NONE = -1
FAR_STEPS = 4_000_000 >> TIME_LOW_BITS
"""Distance of an upper time from the chunk's that is odd: four seconds."""

NO_WRAP_BITS = 62
"""Bits of a counter that never wraps, as the lower time within a unit of the upper."""

UNKNOWN_TYPES = (1 << 0x1) | (1 << 0x9) | (1 << 0xB) | (1 << 0xC) | (1 << 0xD)
"""Types that the format does not define, as a bit set."""


class Evt3Decoder(WordDecoder):
    """Turns EVT3 words into events; keeps time, row and vector base from call to call."""

    name = "evt3"
    word = np.dtype("<u2")
    events_per_word = 12
    low_bits = TIME_LOW_BITS
    high_bits = TIME_HIGH_BITS

    def decode(self, words: NDArray[Any], out: Columns) -> int:
        """Decode words into the columns and return the number of events."""
        return decode_kernel(words, *out, self.state)

    def suspects(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a suspicion for each byte offset: 0 none, 1 odd, 2 unknown type."""
        out = np.empty(max(len(data) - 1, 0), np.uint8)
        suspects_kernel(data, self.expected_high(data), out, self.state)
        return out

    def time_words(self, words: NDArray[Any]) -> TimeWords:
        """Mend the lower times in place and return the upper ones."""
        self.mended += mend_low_kernel(words, self.state)
        out = TimeWords.empty(len(words))
        return out.first(time_words_kernel(words, *out))

    def set_time_words(self, words: NDArray[Any], times: TimeWords) -> None:
        """Write mended upper times back into the words."""
        words[times.position] = (TIME_HIGH << 12) | times.value


@njit(cache=True, nogil=True)
def decode_kernel(
    words: NDArray[np.uint16],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    t: NDArray[np.int64],
    triggers: NDArray[np.int64],
    state: NDArray[np.int64],
) -> Any:
    """Decode words into the columns; return the number of events."""
    width, height = state[WIDTH], state[HEIGHT]
    row, now, n = state[ROW], state[NOW], 0
    state[EVENTS_BEFORE] = NONE
    for i in range(len(words)):
        kind, value = words[i] >> 12, np.int64(words[i] & 0xFFF)
        if kind == ADDR_X:
            if (value & 0x7FF) < width and row < height and now >= 0:
                x[n], y[n], p[n], t[n] = value & 0x7FF, row, value >> 11, now
                n += 1
            else:
                state[OUTSIDE if row < NO_ROW and now >= 0 else MISSING] += 1
        elif kind == ADDR_Y:
            row = value & 0x7FF
        elif kind == TIME_LOW:
            if state[HIGH] >= 0:
                now = lone_low_kernel(state, value, n)
        elif kind in (VECT_12, VECT_8):
            mask = _visible_kernel(value, 12 if kind == VECT_12 else 8, row, state)
            column, polarity = state[VECTOR_X], state[VECTOR_P] != 0
            while mask:
                x[n], y[n], p[n], t[n] = column + LOWEST_BIT[mask], row, polarity, now
                mask &= mask - 1
                n += 1
            if column >= 0:
                state[VECTOR_X] = column + (12 if kind == VECT_12 else 8)
        elif kind == BASE_X:
            state[VECTOR_X], state[VECTOR_P] = value & 0x7FF, value >> 11
        else:
            _rare_kernel(np.int64(words[i]), i, triggers, state)
            now = state[NOW]
    state[ROW], state[NOW] = row, now
    return n


@njit(cache=True, nogil=True)
def _visible_kernel(mask: Integer, length: Integer, row: Integer, state: NDArray[np.int64]) -> Any:
    """Return the part of a vector's mask that lies on the sensor; count the rest."""
    mask &= (1 << length) - 1
    column = state[VECTOR_X]
    if column >= 0 and column + length <= state[WIDTH] and row < state[HEIGHT] and state[NOW] >= 0:
        return mask
    known = column >= 0 and row < NO_ROW and state[NOW] >= 0
    room = max(state[WIDTH] - column, 0) if known and row < state[HEIGHT] else 0
    kept = mask & ((1 << min(room, length)) - 1)
    lost = mask & ~kept
    while lost:
        state[OUTSIDE if known else MISSING] += 1
        lost &= lost - 1
    return kept


@njit(cache=True, nogil=True)
def _rare_kernel(
    word: Integer, i: Integer, triggers: NDArray[np.int64], state: NDArray[np.int64]
) -> None:
    kind = word >> 12
    if kind == TIME_HIGH:
        time_high_kernel(state, word & 0xFFF, TIME_LOW_BITS, TIME_HIGH_BITS, i)
    elif kind == TRIGGER:
        if state[NOW] >= 0:
            triggers[state[TRIGGERS], 0] = state[NOW]
            triggers[state[TRIGGERS], 1] = (word >> 8) & 0xF
            triggers[state[TRIGGERS], 2] = word & 1
            state[TRIGGERS] += 1
    elif word == PADDING:
        state[PADDINGS] += 1
    elif kind in (OTHERS, CONTINUED_4, CONTINUED_12):
        state[VENDOR] += 1
    else:
        state[UNKNOWN] += 1


@njit(cache=True, nogil=True)
def suspects_kernel(
    data: NDArray[np.uint8], high: Integer, out: NDArray[np.uint8], state: NDArray[np.int64]
) -> None:
    """Mark for each byte offset what is wrong with the word that begins there."""
    for i in range(len(out)):
        word = np.int64(data[i]) | (np.int64(data[i + 1]) << 8)
        kind, address = word >> 12, word & 0x7FF
        limit = state[HEIGHT] if kind == ADDR_Y else state[WIDTH]
        if (UNKNOWN_TYPES >> kind) & 1:
            out[i] = 0 if word == PADDING else 2
        elif kind in (ADDR_Y, ADDR_X, BASE_X):
            out[i] = address >= limit
        elif kind == TIME_HIGH:
            out[i] = abs((word & 0xFFF) - high) > FAR_STEPS
        else:
            out[i] = kind in (TRIGGER, OTHERS, CONTINUED_4, CONTINUED_12)


@njit(cache=True, nogil=True)
def time_words_kernel(
    words: NDArray[np.uint16],
    position: NDArray[np.int64],
    value: NDArray[np.int64],
    wrapped: NDArray[np.bool_],
) -> Any:
    """Find the upper times, and whether the lower time fell from before to after each of them."""
    n, low = 0, 0
    fresh = False
    for i in range(len(words)):
        kind = words[i] >> 12
        if kind == TIME_HIGH:
            position[n], value[n], wrapped[n] = i, words[i] & 0xFFF, False
            n, fresh = n + 1, True
        elif kind == TIME_LOW:
            after = np.int64(words[i] & 0xFFF)
            if fresh and n:
                wrapped[n - 1] = after < low
            low, fresh = after, False
    return n


@njit(cache=True, nogil=True)
def mend_low_kernel(words: NDArray[np.uint16], state: NDArray[np.int64]) -> Any:
    """Replace lower times that do not fit into a course of time; return how many."""
    position = np.empty(len(words), np.int64)
    mended, n, high = 0, 0, state[HIGH]
    for i in range(len(words)):
        kind, value = words[i] >> 12, words[i] & 0xFFF
        if kind == TIME_LOW:
            position[n] = i
            n += 1
        elif kind == TIME_HIGH and value != high:
            mended += _mend_unit_kernel(words, position[:n])
            n, high = 0, value
    return mended + _mend_unit_kernel(words, position[:n])


@njit(cache=True, nogil=True)
def _mend_unit_kernel(words: NDArray[np.uint16], position: NDArray[np.int64]) -> Any:
    """Mend the lower times of one unit of the upper time."""
    value = np.empty(len(position), np.int64)
    for k in range(len(position)):
        value[k] = words[position[k]] & 0xFFF
    mended = mend_high_kernel(value, np.zeros(len(value), np.bool_), NONE, NO_WRAP_BITS)
    for k in range(len(position)):
        words[position[k]] = (TIME_LOW << 12) | value[k]
    return mended


class Evt3Encoder:
    """Turns packets into EVT3 words; vectors are used where they take fewer words.

    Time words are written for every 4,096 us, also in silence, as a camera does (and repeated where
    events follow): a reader can tell silence from loss, and wraps are never ambiguous. Vectors are
    complete 12 + 12 + 8 triples.
    """

    name = "evt3"
    time_bits = TIME_LOW_BITS + TIME_HIGH_BITS

    def __init__(self) -> None:
        self._state = np.full(5, NONE, np.int64)

    def encode(
        self,
        t: NDArray[np.int64],
        x: NDArray[np.uint16],
        y: NDArray[np.uint16],
        p: NDArray[np.bool_],
    ) -> NDArray[np.uint16]:
        """Return the words for events in order of time (``t`` counted from the file's base)."""
        if not len(t):
            return np.empty(0, np.uint16)
        first = int(t[0] >> TIME_LOW_BITS) if self._state[0] == NONE else int(self._state[0])
        silence = int(t[-1] >> TIME_LOW_BITS) - first
        words = np.empty(5 * len(t) + silence + 1, np.uint16)
        return words[: encode_kernel(t, x, y, p, words, self._state)]


@njit(cache=True, nogil=True)
def encode_kernel(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    out: NDArray[np.uint16],
    state: NDArray[np.int64],
) -> Any:
    """Write words to ``out``; ``state`` is (high, low, row, next vector base, its polarity)."""
    n, i = 0, 0
    while i < len(t):
        if t[i] != ((state[0] << 12) | state[1]) or state[1] < 0:
            n = _time_kernel(t[i], out, n, state)
        if y[i] != state[2]:
            state[2] = y[i]
            out[n] = (ADDR_Y << 12) | y[i]
            n += 1
        last, mask = _run_kernel(t, x, y, p, i)
        joined = state[3] == x[i] and state[4] == p[i]
        if last - i > (VECTOR_WORDS if joined else VECTOR_WORDS + 1):
            n = _vector_kernel(x[i], p[i], mask, joined, out, n, state)
            i = last
        else:
            out[n] = (ADDR_X << 12) | (np.int64(p[i]) << 11) | x[i]
            n += 1
            i += 1
    return n


@njit(cache=True, nogil=True)
def _time_kernel(t: Integer, out: NDArray[np.uint16], n: Integer, state: NDArray[np.int64]) -> Any:
    high = t >> 12
    if high != state[0]:
        first = high if state[0] < 0 else state[0] + 1
        for value in range(first, high + 1):
            out[n] = (TIME_HIGH << 12) | (value & 0xFFF)
            n += 1
        state[0] = high
    elif (t & 0xFFF) >> REPEAT_BITS != state[1] >> REPEAT_BITS:
        out[n] = (TIME_HIGH << 12) | (high & 0xFFF)
        n += 1
    state[1] = t & 0xFFF
    out[n] = (TIME_LOW << 12) | state[1]
    return n + 1


@njit(cache=True, nogil=True)
def _run_kernel(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    i: Integer,
) -> tuple[int, Any]:
    """Return the end and the mask of the events that one vector from event ``i`` can hold."""
    mask, last = 1, i + 1
    while (
        last < len(t)
        and x[last] > x[last - 1]
        and x[last] < x[i] + VECTOR_WIDTH_PX
        and y[last] == y[i]
        and t[last] == t[i]
        and p[last] == p[i]
    ):
        mask |= 1 << (np.int64(x[last]) - np.int64(x[i]))
        last += 1
    return last, mask


@njit(cache=True, nogil=True)
def _vector_kernel(
    x: Integer,
    p: Any,
    mask: Integer,
    joined: Any,
    out: NDArray[np.uint16],
    n: Integer,
    state: NDArray[np.int64],
) -> Any:
    if not joined:
        out[n] = (BASE_X << 12) | (np.int64(p) << 11) | x
        n += 1
    out[n] = (VECT_12 << 12) | (mask & 0xFFF)
    out[n + 1] = (VECT_12 << 12) | ((mask >> 12) & 0xFFF)
    out[n + 2] = (VECT_8 << 12) | ((mask >> 24) & 0xFF)
    state[3] = np.int64(x) + VECTOR_WIDTH_PX
    state[4] = np.int64(p)
    return n + VECTOR_WORDS
