"""The state of a RAW decoder, and the one rule by which all of them keep time.

The wire sends the upper part of the time in words of its own; their counter wraps. Forward is the
smaller surprise: a counter that falls by half of its range or more has wrapped (as OpenEB has it).
A fall of less than 0.1 s is held (time stands still until the wire catches up), a larger one is a
restart: the wire's time is re-based so that it goes on from the last event.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.formats.codec import JUMP_US, RESET_US

# Places in the state: clock, address, sensor, continuity and counters.
HIGH, EPOCH, BASE, NOW, ROW, VECTOR_X, VECTOR_P, WIDTH, HEIGHT = range(9)
REPEATS, CHANGES, UNCONFIRMED, EARLIER, EVENTS_BEFORE = range(9, 14)
FIRST_COUNTER = 14
BACKWARDS, RESET, JUMP, GAP, OUTSIDE, MISSING = range(14, 20)
UNKNOWN, TRIGGERS, PADDINGS, VENDOR, GLITCH = range(20, 25)
FIELDS = 25

# Kinds of damage, in the order of their counters.
COUNTED = (
    "time_backwards", "time_reset", "time_jump", "gap", "out_of_range", "missing_state",
    "unknown_word", "trigger", "padding", "vendor_word", "time_glitch",
)  # fmt: skip

NONE = -1
NO_ROW = 1 << 30  # A row that no sensor has: nothing can be placed yet.

Integer = int | np.integer[Any]  # A number inside of a kernel.

LEAP_US = 1 << 24  # The artefact leap of streams that were restarted on an open device.

# Repeated time words after which a stream is taken for a sensor's, which leaves none out.
REPEATS_OF_A_SENSOR = 16


def new_state(size: tuple[int, int], continuous: bool = False) -> NDArray[np.int64]:
    """Return the state before the first word.

    Args:
        size: ``(width, height)`` beyond which events are dropped, px.
        continuous: Whether the writer is known to leave no time word out, so that holes are gaps.
    """
    state = np.zeros(FIELDS, np.int64)
    state[[HIGH, UNCONFIRMED, VECTOR_X, NOW, EVENTS_BEFORE]] = NONE
    state[ROW] = NO_ROW
    state[WIDTH], state[HEIGHT] = size
    if continuous:
        state[REPEATS] = 1 << 40
    return state


@njit(cache=True, nogil=True)
def time_high_kernel(
    state: NDArray[np.int64], value: Integer, form: tuple[int, int], position: Integer
) -> None:
    """Advance the clock to the upper time ``value`` of the word at ``position``.

    Args:
        state: The decoder's state.
        value: Upper time.
        form: Bits of the lower and of the upper time.
        position: Index of the word in this chunk.
    """
    low_bits, high_bits = form
    if value == state[HIGH]:
        state[REPEATS] += 1
        state[UNCONFIRMED] = NONE
        return
    fresh = state[HIGH] < 0
    step = value - state[HIGH]
    state[HIGH] = value
    state[UNCONFIRMED] = NONE
    if fresh:
        state[BASE] = state[EPOCH] + (value << low_bits)
        state[NOW] = max(state[NOW], state[BASE])
        return
    state[CHANGES] += 1
    if step < 0:
        if -step >= 1 << (high_bits - 1):
            state[EPOCH] += np.int64(1) << (low_bits + high_bits)
            step += 1 << high_bits
        elif -step << low_bits >= RESET_US:
            state[EPOCH] = state[NOW] - (value << low_bits)
            state[RESET] += 1
    if step > 1:
        if step << low_bits >= RESET_US:
            state[UNCONFIRMED] = position
        _leap_kernel(state, step, low_bits)
    state[BASE] = state[EPOCH] + (value << low_bits)
    if state[BASE] > state[NOW]:
        state[NOW] = state[BASE]


@njit(cache=True, nogil=True)
def _leap_kernel(state: NDArray[np.int64], step: Integer, low_bits: Integer) -> None:
    leap_us = step << low_bits
    if leap_us >= JUMP_US:
        state[JUMP] += 1
        if abs(leap_us - LEAP_US) < RESET_US:
            state[EPOCH] -= LEAP_US
    elif state[REPEATS] >= REPEATS_OF_A_SENSOR and state[REPEATS] >= state[CHANGES]:
        state[GAP] += 1


@njit(cache=True, nogil=True)
def time_low_kernel(state: NDArray[np.int64], low: Integer) -> Any:
    """Return the time of the lower part ``low``, us, held where it would go back."""
    now = state[BASE] + low
    if now < state[NOW]:
        state[BACKWARDS] += 1
        return state[NOW]
    state[NOW] = now
    return now


@njit(cache=True, nogil=True)
def lone_low_kernel(state: NDArray[np.int64], low: Integer, events: Integer) -> Any:
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


class Columns(NamedTuple):
    """Buffers that a kernel fills: events, and triggers as (t_us, channel, value)."""

    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    p: NDArray[np.bool_]
    t: NDArray[np.int64]
    triggers: NDArray[np.int64]

    @classmethod
    def empty(cls, events: int, words: int) -> Self:
        """Return buffers for at most ``events`` events and ``words`` triggers."""
        return cls(
            np.empty(events, np.uint16),
            np.empty(events, np.uint16),
            np.empty(events, np.bool_),
            np.empty(events, np.int64),
            np.empty((words, 3), np.int64),
        )
