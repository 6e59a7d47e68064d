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

from spikingtac.events.evt import fields as at
from spikingtac.events.evt import wire
from spikingtac.events.evt.decoder import (
    Columns,
    Integer,
    WordDecoder,
    lone_low_kernel,
    read_only,
    time_high_kernel,
)
from spikingtac.events.evt.salvage import mend_high_kernel
from spikingtac.events.evt.wire import EVT3, TimeWords, WordView, view_evt3

# Bits of a counter that never wraps, as the lower time within a unit of the upper.
NO_WRAP_BITS = 62
LOW_BITS, HIGH_BITS = EVT3.low_bits, EVT3.high_bits

# Index of the lowest set bit of each 12-bit mask.
LOWEST_BIT = np.array([12] + [(mask & -mask).bit_length() - 1 for mask in range(1, 4096)], np.uint8)


class Evt3Decoder(WordDecoder):
    """Turns EVT3 words into events; keeps time, row and vector base from call to call."""

    name = "evt3"
    form = EVT3
    word = np.dtype("<u2")
    events_per_word = 12

    def decode(self, words: NDArray[Any], out: Columns) -> int:
        """Decode words into the columns and return the number of events."""
        return decode_kernel(read_only(words), out, self.state)

    def view(self, words: NDArray[Any]) -> WordView:
        """Return what each word says."""
        return view_evt3(words, self.size)

    def time_words(self, words: NDArray[Any]) -> TimeWords:
        """Mend the lower times in place, within each unit of the upper, and return the upper."""
        times = super().time_words(words)
        before = np.concatenate(([self.state[at.HIGH]], times.value[:-1]))
        units = times.position[times.value != before]
        low = np.flatnonzero(words >> 12 == wire.TIME_LOW)
        for places in np.split(low, np.searchsorted(low, units)):
            value = (words[places] & 0xFFF).astype(np.int64)
            whole = np.zeros(len(value), np.bool_)
            self.mended += int(mend_high_kernel(value, whole, at.NONE, NO_WRAP_BITS))
            words[places] = (wire.TIME_LOW << 12) | value
        return super().time_words(words)


@njit(cache=True, nogil=True)
def decode_kernel(words: NDArray[np.uint16], out: Columns, state: NDArray[np.int64]) -> Any:
    """Decode words into the columns; return the number of events."""
    x, y, p, t, triggers = out
    width, height = state[at.WIDTH], state[at.HEIGHT]
    row, now, n = state[at.ROW], state[at.NOW], 0
    state[at.EVENTS_BEFORE] = at.NONE
    for i in range(len(words)):
        kind, value = words[i] >> 12, np.int64(words[i] & 0xFFF)
        if kind == wire.ADDR_X:
            if (value & 0x7FF) < width and row < height and now >= 0:
                x[n], y[n], p[n], t[n] = value & 0x7FF, row, value >> 11, now
                n += 1
            else:
                state[at.OUTSIDE if row < at.NO_ROW and now >= 0 else at.MISSING] += 1
        elif kind == wire.ADDR_Y:
            row = value & 0x7FF
        elif kind == wire.TIME_LOW:
            now = lone_low_kernel(state, value, n)
        elif kind in (wire.VECT_12, wire.VECT_8):
            column, polarity = state[at.VECTOR_X], state[at.VECTOR_P] != 0
            mask = _visible_kernel(value, 12 if kind == wire.VECT_12 else 8, row, state)
            while mask:
                x[n], y[n], p[n], t[n] = column + LOWEST_BIT[mask], row, polarity, now
                mask &= mask - 1
                n += 1
        elif kind == wire.BASE_X:
            state[at.VECTOR_X], state[at.VECTOR_P] = value & 0x7FF, value >> 11
        else:
            _rare_kernel(np.int64(words[i]), i, triggers, state)
            now = state[at.NOW]
    state[at.ROW], state[at.NOW] = row, now
    return n


@njit(cache=True, nogil=True)
def _visible_kernel(mask: Integer, length: Integer, row: Integer, state: NDArray[np.int64]) -> Any:
    """Return the part of a vector's mask on the sensor, count the rest, move the base on."""
    mask &= (1 << length) - 1
    column = state[at.VECTOR_X]
    if column >= 0:
        state[at.VECTOR_X] = column + length
    known = column >= 0 and row < at.NO_ROW and state[at.NOW] >= 0
    if known and column + length <= state[at.WIDTH] and row < state[at.HEIGHT]:
        return mask
    room = max(state[at.WIDTH] - column, 0) if known and row < state[at.HEIGHT] else 0
    kept = mask & ((1 << min(room, length)) - 1)
    lost = mask & ~kept
    while lost:
        state[at.OUTSIDE if known else at.MISSING] += 1
        lost &= lost - 1
    return kept


@njit(cache=True, nogil=True)
def _rare_kernel(
    word: Integer, i: Integer, triggers: NDArray[np.int64], state: NDArray[np.int64]
) -> None:
    kind = word >> 12
    if kind == wire.TIME_HIGH:
        time_high_kernel(state, word & 0xFFF, LOW_BITS, HIGH_BITS, i)
    elif kind == wire.TRIGGER:
        if state[at.NOW] >= 0:
            triggers[state[at.TRIGGERS], 0] = state[at.NOW]
            triggers[state[at.TRIGGERS], 1] = (word >> 8) & 0xF
            triggers[state[at.TRIGGERS], 2] = word & 1
            state[at.TRIGGERS] += 1
    elif word == wire.EVT3_PADDING:
        state[at.PADDINGS] += 1
    elif kind in (wire.OTHERS, wire.CONTINUED_4, wire.CONTINUED_12):
        state[at.VENDOR] += 1
    else:
        state[at.UNKNOWN] += 1
