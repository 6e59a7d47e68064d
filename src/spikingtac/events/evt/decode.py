"""Decoders of the three word formats of RAW, EVT 2.0, 2.1 and 3.0, and the time that they keep.

Source: Prophesee, "EVT 2.0 Format", "EVT 2.1 Format", "EVT 3.0 Format" (public documentation).
EVT2 has words of 32 bits, one event each. Counted from the top, such a word holds its type (4 bits:
0 OFF, 1 ON), the lower time (6), the column (11) and the row (11). EVT2.1 has words of 64 bits: the
upper half is an EVT2 word, whose column is that of the first pixel; the lower half is the mask of
the 32 pixels. Words come in three byte orders: ``little`` (GenX320; the default), ``legacy``
(IMX636 and older: the upper half first, each half little-endian) and ``big``. EVT3 has words of 16
bits whose time, row and vector base are kept as state. The upper four bits are the type.

The wire sends the upper part of the time in words of its own; their counter wraps. A counter that
falls by half of its range or more has wrapped (as OpenEB has it). A fall of less than 0.1 s is held
(time stands still until the wire catches up). A larger one is a restart: the wire's time goes on
from the last event.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.evt import wire
from spikingtac.events.evt.wire import EVT2, EVT3
from spikingtac.events.formats.codec import JUMP_US, RESET_US

State = NDArray[np.int64]
Integer = int | np.integer[Any]  # A number inside of a kernel.

# Places in the state: clock, address, sensor, continuity and counters.
HIGH, EPOCH, BASE, NOW, ROW, VECTOR_X, VECTOR_P, WIDTH, HEIGHT = range(9)
REPEATS, CHANGES, UNCONFIRMED, EARLIER, EVENTS_BEFORE = range(9, 14)
BACKWARDS, RESET, JUMP, GAP, OUTSIDE, MISSING = range(14, 20)
UNKNOWN, TRIGGERS, PADDINGS, VENDOR, GLITCH = range(20, 25)
FIRST_COUNTER, FIELDS = BACKWARDS, 25

# Kinds of damage, in the order of their counters.
COUNTED = (
    "time_backwards", "time_reset", "time_jump", "gap", "out_of_range", "missing_state",
    "unknown_word", "trigger", "padding", "vendor_word", "time_glitch",
)  # fmt: skip

NONE = -1
NO_ROW = 1 << 30  # A row that no sensor has: nothing can be placed yet.
LEAP_US = 1 << 24  # The artefact leap of streams that were restarted on an open device.

# Repeated time words after which a stream is taken for a sensor's, which leaves none out.
REPEATS_OF_A_SENSOR = 16
EVT2_FORM, EVT3_FORM, EVT2_BITS = EVT2[:5], EVT3[:5], EVT2.low_bits

# Index of the lowest set bit of each mask of 16 bits.
LOWEST_BIT = np.array([0] + [(m & -m).bit_length() - 1 for m in range(1, 1 << 16)], np.uint8)

# Buffers that a kernel fills: x, y, p and t of events, and triggers as (t_us, channel, value).
Columns = tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_], State, State]


def new_columns(events: int, words: int) -> Columns:
    """Return buffers for at most so many events, and a trigger for each word."""
    x, y = np.empty(events, np.uint16), np.empty(events, np.uint16)
    p, t = np.empty(events, np.bool_), np.empty(events, np.int64)
    return x, y, p, t, np.empty((words, 3), np.int64)


def new_state(size: tuple[int, int], continuous: bool = False) -> State:
    """Return the state before the first word.

    Args:
        size: ``(width, height)`` beyond which events are dropped, px.
        continuous: Whether the writer is known to leave no time word out, so that holes are gaps.
    """
    state = np.zeros(FIELDS, np.int64)
    state[[HIGH, UNCONFIRMED, VECTOR_X, NOW, EVENTS_BEFORE]] = NONE
    state[ROW] = NO_ROW
    state[WIDTH], state[HEIGHT] = size
    state[REPEATS] = 1 << 40 if continuous else 0
    return state


@njit(cache=True, nogil=True)
def time_high_kernel(
    state: State, value: Integer, form: tuple[int, int], position: Integer
) -> None:
    """Advance the clock to the upper time ``value`` of the word at ``position``.

    Args:
        state: The decoder's state.
        value: Upper time.
        form: Bits of the lower and of the upper time.
        position: Index of the word in this chunk.
    """
    low_bits, high_bits = form
    state[UNCONFIRMED] = NONE
    if value == state[HIGH]:
        state[REPEATS] += 1
        return
    step = value - state[HIGH] if state[HIGH] >= 0 else np.int64(0)
    state[CHANGES] += state[HIGH] >= 0
    state[HIGH] = value
    if step < 0:
        if -step >= 1 << (high_bits - 1):
            state[EPOCH] += np.int64(1) << (low_bits + high_bits)
            step += 1 << high_bits
        elif -step << low_bits >= RESET_US:
            state[EPOCH] = state[NOW] - (value << low_bits)
            state[RESET] += 1
    leap_us = step << low_bits
    if leap_us >= JUMP_US:
        state[JUMP] += 1
        if abs(leap_us - LEAP_US) < RESET_US:
            state[EPOCH] -= LEAP_US
    elif step > 1 and state[REPEATS] >= max(REPEATS_OF_A_SENSOR, state[CHANGES]):
        state[GAP] += 1
    if leap_us >= RESET_US:
        state[UNCONFIRMED] = position
    state[BASE] = state[EPOCH] + (value << low_bits)
    state[NOW] = max(state[NOW], state[BASE])


@njit(cache=True, nogil=True)
def time_low_kernel(state: State, low: Integer) -> Any:
    """Return the time of the lower part ``low``, us, held where it would go back."""
    now = state[BASE] + low
    if now < state[NOW]:
        state[BACKWARDS] += 1
        return state[NOW]
    state[NOW] = now
    return now


@njit(cache=True, nogil=True)
def lone_low_kernel(state: State, low: Integer, events: Integer) -> Any:
    """Do the same for a word that holds the lower time alone.

    Gen 4.1 sensors now and then send such a word and correct it at once. If no event came between,
    nothing was stamped, and the correction counts: the library evt3 and the wire agree on that.

    Args:
        state: The decoder's state.
        low: Lower time.
        events: Events decoded so far in this chunk.
    """
    if state[HIGH] < 0:
        return state[NOW]
    now = state[BASE] + low
    if now < state[NOW]:
        if state[EVENTS_BEFORE] != events or now < state[EARLIER]:
            state[BACKWARDS] += 1
            return state[NOW]
        state[GLITCH] += 1
    else:
        state[EARLIER] = state[NOW]
    state[EVENTS_BEFORE] = events
    state[NOW] = now
    return now


@njit(cache=True, nogil=True)
def decode_evt2_kernel(words: NDArray[np.uint32], out: Columns, state: State) -> Any:
    """Decode words into the columns; return the number of events."""
    x, y, p, t, triggers = out
    width, height = state[WIDTH], state[HEIGHT]
    n, base, now = 0, state[BASE], state[NOW]
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
                    state[BACKWARDS] += 1
                x[n], y[n], p[n], t[n] = column, row, kind, now
                n += 1
            else:
                state[OUTSIDE if now >= 0 else MISSING] += 1
        else:
            state[NOW] = now
            _rare_kernel(word, i, EVT2_FORM, triggers, state)
            base, now = state[BASE], state[NOW]
    state[NOW] = now
    return n


@njit(cache=True, nogil=True)
def decode_evt21_kernel(halves: NDArray[np.uint32], upper: int, out: Columns, state: State) -> Any:
    """Decode words, ``(n, 2)`` halves, the upper in column ``upper``; return the event count."""
    x, y, p, t, triggers = out
    width, height = state[WIDTH], state[HEIGHT]
    n = 0
    for i in range(len(halves)):
        head = np.int64(halves[i, upper])
        kind = head >> 28
        if kind > wire.EVENT_ON:
            _rare_kernel(head, i, EVT2_FORM, triggers, state)
            continue
        mask, column, row = np.int64(halves[i, 1 - upper]), (head >> 11) & 0x7FF, head & 0x7FF
        timed = state[HIGH] >= 0
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
    width, height = state[WIDTH], state[HEIGHT]
    row, now, n = state[ROW], state[NOW], 0
    state[EVENTS_BEFORE] = NONE
    for i in range(len(words)):
        kind, value = words[i] >> 12, np.int64(words[i] & 0xFFF)
        if kind == wire.ADDR_X:
            if (value & 0x7FF) < width and row < height and now >= 0:
                x[n], y[n], p[n], t[n] = value & 0x7FF, row, value >> 11, now
                n += 1
            else:
                state[OUTSIDE if row < NO_ROW and now >= 0 else MISSING] += 1
        elif kind == wire.ADDR_Y:
            row = value & 0x7FF
        elif kind == wire.TIME_LOW:
            now = lone_low_kernel(state, value, n)
        elif kind in (wire.VECT_12, wire.VECT_8):
            column, polarity = state[VECTOR_X], state[VECTOR_P] != 0
            mask = _vector_kernel(value, 12 if kind == wire.VECT_12 else 8, row, state)
            while mask:
                x[n], y[n], p[n], t[n] = column + LOWEST_BIT[mask], row, polarity, now
                mask &= mask - 1
                n += 1
        elif kind == wire.BASE_X:
            state[VECTOR_X], state[VECTOR_P] = value & 0x7FF, value >> 11
        else:
            _rare_kernel(np.int64(words[i]), i, EVT3_FORM, triggers, state)
            now = state[NOW]
    state[ROW], state[NOW] = row, now
    return n


@njit(cache=True, nogil=True)
def _vector_kernel(mask: Integer, length: Integer, row: Integer, state: State) -> Any:
    """Return the part of a vector's mask on the sensor, and move the base on."""
    mask &= (1 << length) - 1
    column = state[VECTOR_X]
    if column >= 0:
        state[VECTOR_X] = column + length
    known = column >= 0 and row < NO_ROW and state[NOW] >= 0
    if known and column + length <= state[WIDTH] and row < state[HEIGHT]:
        return mask
    return _visible_kernel(mask, length, column, row, known, state)


@njit(cache=True, nogil=True)
def _visible_kernel(
    mask: Integer, length: Integer, column: Integer, row: Integer, known: Any, state: State
) -> Any:
    """Return the part of a mask that lies on the sensor; count the rest."""
    room = max(state[WIDTH] - column, 0) if known and row < state[HEIGHT] else 0
    kept = mask & ((np.int64(1) << min(room, length)) - 1)
    lost = mask & ~kept
    while lost:
        state[OUTSIDE if known else MISSING] += 1
        lost &= lost - 1
    return kept


@njit(cache=True, nogil=True)
def _rare_kernel(
    word: Integer, i: Integer, form: tuple[int, ...], triggers: State, state: State
) -> None:
    """Take a word that is no event, or the upper half of one of EVT2.1, by its format's numbers."""
    low_bits, high_bits, padding, known_types, channels = form
    kind = word >> high_bits
    if kind == wire.TIME_HIGH:
        time_high_kernel(state, word & ((1 << high_bits) - 1), (low_bits, high_bits), i)
    elif kind != wire.TRIGGER:
        known = (known_types >> kind) & 1
        state[PADDINGS if word == padding else VENDOR if known else UNKNOWN] += 1
    elif state[NOW] >= 0:
        number, now = state[TRIGGERS], state[NOW]
        if low_bits == EVT2_BITS:  # triggers of EVT3 have the time of the words before
            now = time_low_kernel(state, (word >> 22) & 0x3F)
        triggers[number, 0] = now
        triggers[number, 1], triggers[number, 2] = (word >> 8) & channels, word & 1
        state[TRIGGERS] += 1
