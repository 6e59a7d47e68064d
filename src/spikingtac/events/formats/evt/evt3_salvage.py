"""What salvage must know of EVT3: which words are odd, and where the time is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.formats.evt.clock import HEIGHT, HIGH, NONE, WIDTH, Integer
from spikingtac.events.formats.evt.evt3_words import (
    ADDR_X,
    ADDR_Y,
    BASE_X,
    CONTINUED_4,
    CONTINUED_12,
    OTHERS,
    PADDING,
    TIME_HIGH,
    TIME_LOW,
    TIME_LOW_BITS,
    TRIGGER,
    UNKNOWN_TYPES,
)
from spikingtac.events.formats.evt.salvage import mend_high_kernel

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
