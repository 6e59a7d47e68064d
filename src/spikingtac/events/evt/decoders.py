"""The three word formats of RAW: EVT 2.0, EVT 2.1 and EVT 3.0.

Source: Prophesee, "EVT 2.0 Format", "EVT 2.1 Format", "EVT 3.0 Format" (public documentation).
EVT2 has words of 32 bits, one event each. Counted from the top, such a word holds its type (4 bits:
0 OFF, 1 ON), the lower time (6), the column (11) and the row (11). EVT2.1 has words of 64 bits: the
upper half is an EVT2 word, whose column is that of the first pixel; the lower half is the mask of
the 32 pixels. Words come in three byte orders: ``little`` (GenX320; the default), ``legacy``
(IMX636 and older: the upper half first, each half little-endian) and ``big``. EVT3 has words of 16
bits whose time, row and vector base are kept as state. The upper four bits are the type.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.evt import decoder as at
from spikingtac.events.evt import wire
from spikingtac.events.evt.decoder import (
    Columns,
    Integer,
    lone_low_kernel,
    time_high_kernel,
    time_low_kernel,
)
from spikingtac.events.evt.wire import EVT2, EVT3

EVT2_BITS, EVT3_BITS = EVT2[:2], EVT3[:2]  # Bits of the lower and of the upper time.
EVT2_TYPES = EVT2.known_types

# Index of the lowest set bit of each mask of 16 bits.
LOWEST_BIT = np.array([0] + [(m & -m).bit_length() - 1 for m in range(1, 1 << 16)], np.uint8)

State = NDArray[np.int64]


@njit(cache=True, nogil=True)
def decode_evt2_kernel(words: NDArray[np.uint32], out: Columns, state: State) -> Any:
    """Decode words into the columns; return the number of events."""
    x, y, p, t, triggers = out
    width, height = state[at.WIDTH], state[at.HEIGHT]
    n, base, now = 0, state[at.BASE], state[at.NOW]
    for i in range(len(words)):
        word = np.int64(words[i])
        kind = word >> 28
        if kind <= wire.EVENT_ON:
            column, row = (word >> 11) & 0x7FF, word & 0x7FF
            if now >= 0 and column < width and row < height:
                stamped = base + ((word >> 22) & 0x3F)
                if stamped >= now:
                    now = stamped
                else:
                    state[at.BACKWARDS] += 1
                x[n], y[n], p[n], t[n] = column, row, kind, now
                n += 1
            else:
                state[at.OUTSIDE if now >= 0 else at.MISSING] += 1
        else:
            state[at.NOW] = now
            _rare_evt2_kernel(word, i, triggers, state)
            base, now = state[at.BASE], state[at.NOW]
    state[at.NOW] = now
    return n


@njit(cache=True, nogil=True)
def decode_evt21_kernel(halves: NDArray[np.uint32], upper: int, out: Columns, state: State) -> Any:
    """Decode words, ``(n, 2)`` halves, the upper in column ``upper``; return the event count."""
    x, y, p, t, triggers = out
    width, height = state[at.WIDTH], state[at.HEIGHT]
    n = 0
    for i in range(len(halves)):
        head = np.int64(halves[i, upper])
        kind = head >> 28
        if kind > wire.EVENT_ON:
            _rare_evt2_kernel(head, i, triggers, state)
            continue
        mask, column, row = np.int64(halves[i, 1 - upper]), (head >> 11) & 0x7FF, head & 0x7FF
        timed = state[at.HIGH] >= 0
        if not timed or column + wire.VECTOR_WIDTH_PX > width or row >= height:
            mask = _visible_kernel(mask, wire.VECTOR_WIDTH_PX, column, row, timed, state)
        if not mask:
            continue
        now = time_low_kernel(state, (head >> 22) & 0x3F)
        for _half in range(2):
            bits = mask & 0xFFFF
            while bits:
                x[n], y[n], p[n], t[n] = column + LOWEST_BIT[bits], row, kind, now
                bits &= bits - 1
                n += 1
            mask >>= 16
            column += 16
    return n


@njit(cache=True, nogil=True)
def decode_evt3_kernel(words: NDArray[np.uint16], out: Columns, state: State) -> Any:
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
            mask = _vector_kernel(value, 12 if kind == wire.VECT_12 else 8, row, state)
            while mask:
                x[n], y[n], p[n], t[n] = column + LOWEST_BIT[mask], row, polarity, now
                mask &= mask - 1
                n += 1
        elif kind == wire.BASE_X:
            state[at.VECTOR_X], state[at.VECTOR_P] = value & 0x7FF, value >> 11
        else:
            _rare_evt3_kernel(np.int64(words[i]), i, triggers, state)
            now = state[at.NOW]
    state[at.ROW], state[at.NOW] = row, now
    return n


@njit(cache=True, nogil=True)
def _vector_kernel(mask: Integer, length: Integer, row: Integer, state: State) -> Any:
    """Return the part of a vector's mask on the sensor, and move the base on."""
    mask &= (1 << length) - 1
    column = state[at.VECTOR_X]
    if column >= 0:
        state[at.VECTOR_X] = column + length
    known = column >= 0 and row < at.NO_ROW and state[at.NOW] >= 0
    if known and column + length <= state[at.WIDTH] and row < state[at.HEIGHT]:
        return mask
    return _visible_kernel(mask, length, column, row, known, state)


@njit(cache=True, nogil=True)
def _visible_kernel(
    mask: Integer, length: Integer, column: Integer, row: Integer, known: Any, state: State
) -> Any:
    """Return the part of a mask that lies on the sensor; count the rest."""
    room = max(state[at.WIDTH] - column, 0) if known and row < state[at.HEIGHT] else 0
    kept = mask & ((np.int64(1) << min(room, length)) - 1)
    lost = mask & ~kept
    while lost:
        state[at.OUTSIDE if known else at.MISSING] += 1
        lost &= lost - 1
    return kept


@njit(cache=True, nogil=True)
def _rare_evt2_kernel(word: Integer, i: Integer, triggers: State, state: State) -> None:
    """Take a 32-bit word (of EVT2, or the upper half of one of EVT2.1) that is no event."""
    kind = word >> 28
    if kind == wire.TIME_HIGH:
        time_high_kernel(state, word & 0xFFFFFFF, EVT2_BITS, i)
    elif kind == wire.TRIGGER:
        if state[at.HIGH] >= 0:
            now = time_low_kernel(state, (word >> 22) & 0x3F)
            _trigger_kernel(now, (word >> 8) & 0x1F, word & 1, triggers, state)
    elif word == wire.EVT2_PADDING:
        state[at.PADDINGS] += 1
    elif (EVT2_TYPES >> kind) & 1:
        state[at.VENDOR] += 1
    else:
        state[at.UNKNOWN] += 1


@njit(cache=True, nogil=True)
def _rare_evt3_kernel(word: Integer, i: Integer, triggers: State, state: State) -> None:
    kind = word >> 12
    if kind == wire.TIME_HIGH:
        time_high_kernel(state, word & 0xFFF, EVT3_BITS, i)
    elif kind == wire.TRIGGER:
        if state[at.NOW] >= 0:
            _trigger_kernel(state[at.NOW], (word >> 8) & 0xF, word & 1, triggers, state)
    elif word == wire.EVT3_PADDING:
        state[at.PADDINGS] += 1
    elif kind in (wire.OTHERS, wire.CONTINUED_4, wire.CONTINUED_12):
        state[at.VENDOR] += 1
    else:
        state[at.UNKNOWN] += 1


@njit(cache=True, nogil=True)
def _trigger_kernel(
    t_us: Integer, channel: Integer, value: Integer, triggers: State, state: State
) -> None:
    number = state[at.TRIGGERS]
    triggers[number, 0], triggers[number, 1], triggers[number, 2] = t_us, channel, value
    state[at.TRIGGERS] += 1
