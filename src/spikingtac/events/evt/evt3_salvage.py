"""EVT 3.0 on the wire, and what salvage must know of it: odd words, and where the time is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.evt.decoder import HEIGHT, HIGH, NONE, WIDTH, Integer
from spikingtac.events.evt.salvage import mend_high_kernel

ADDR_Y, ADDR_X, BASE_X, VECT_12, VECT_8 = 0x0, 0x2, 0x3, 0x4, 0x5
TIME_LOW, CONTINUED_4, TIME_HIGH, TRIGGER, OTHERS, CONTINUED_12 = 0x6, 0x7, 0x8, 0xA, 0xE, 0xF
PADDING = 0x9999
"""Filler that some USB bridges send to complete a buffer."""

TIME_LOW_BITS = TIME_HIGH_BITS = 12
UNKNOWN_TYPES = (1 << 0x1) | (1 << 0x9) | (1 << 0xB) | (1 << 0xC) | (1 << 0xD)
"""Types that the format does not define, as a bit set."""


FAR_STEPS = 4_000_000 >> TIME_LOW_BITS
"""Distance of an upper time from the chunk's that is odd: four seconds."""

NO_WRAP_BITS = 62
"""Bits of a counter that never wraps, as the lower time within a unit of the upper."""


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
