"""The state of a RAW decoder, the one rule by which all of them keep time, and their shape.

The wire sends the upper part of the time in words of its own; their counter wraps. Forward is the
smaller surprise: a counter that falls by half of its range or more has wrapped (as OpenEB has it).
A fall of less than 0.1 s is held (time stands still until the wire catches up), a larger one is a
restart: the wire's time is re-based so that it goes on from the last event.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from spikingtac.events.evt import fields as at
from spikingtac.events.evt.wire import TIME_HIGH, TimeWords, WordFormat, WordView, time_words
from spikingtac.events.formats.codec import JUMP_US, RESET_US
from spikingtac.types import LossCounters

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
    state = np.zeros(at.FIELDS, np.int64)
    state[[at.HIGH, at.UNCONFIRMED, at.VECTOR_X, at.NOW, at.EVENTS_BEFORE]] = at.NONE
    state[at.ROW] = at.NO_ROW
    state[at.WIDTH], state[at.HEIGHT] = size
    if continuous:
        state[at.REPEATS] = 1 << 40
    return state


def take_counts(state: NDArray[np.int64], losses: LossCounters) -> None:
    """Move the state's counters to the losses."""
    if not state[at.FIRST_COUNTER :].any():  # as nearly always: this is asked at every read
        return
    for kind, count in zip(at.COUNTED, state[at.FIRST_COUNTER :].tolist(), strict=True):
        losses.add(kind, count)
    state[at.FIRST_COUNTER :] = 0


@njit(cache=True, nogil=True)
def time_high_kernel(
    state: NDArray[np.int64],
    value: Integer,
    low_bits: Integer,
    high_bits: Integer,
    position: Integer,
) -> None:
    """Advance the clock to the upper time ``value`` of the word at ``position``."""
    if value == state[at.HIGH]:
        state[at.REPEATS] += 1
        state[at.UNCONFIRMED] = at.NONE
        return
    fresh = state[at.HIGH] < 0
    step = value - state[at.HIGH]
    state[at.HIGH] = value
    state[at.UNCONFIRMED] = at.NONE
    if fresh:
        state[at.BASE] = state[at.EPOCH] + (value << low_bits)
        state[at.NOW] = max(state[at.NOW], state[at.BASE])
        return
    state[at.CHANGES] += 1
    if step < 0:
        if -step >= 1 << (high_bits - 1):
            state[at.EPOCH] += np.int64(1) << (low_bits + high_bits)
            step += 1 << high_bits
        elif -step << low_bits >= RESET_US:
            state[at.EPOCH] = state[at.NOW] - (value << low_bits)
            state[at.RESET] += 1
    if step > 1:
        if step << low_bits >= RESET_US:
            state[at.UNCONFIRMED] = position
        _leap_kernel(state, step, low_bits)
    state[at.BASE] = state[at.EPOCH] + (value << low_bits)
    if state[at.BASE] > state[at.NOW]:
        state[at.NOW] = state[at.BASE]


@njit(cache=True, nogil=True)
def _leap_kernel(state: NDArray[np.int64], step: Integer, low_bits: Integer) -> None:
    leap_us = step << low_bits
    if leap_us >= JUMP_US:
        state[at.JUMP] += 1
        if abs(leap_us - LEAP_US) < RESET_US:
            state[at.EPOCH] -= LEAP_US
    elif state[at.REPEATS] >= REPEATS_OF_A_SENSOR and state[at.REPEATS] >= state[at.CHANGES]:
        state[at.GAP] += 1


@njit(cache=True, nogil=True)
def time_low_kernel(state: NDArray[np.int64], low: Integer) -> Any:
    """Return the time of the lower part ``low``, us, held where it would go back."""
    now = state[at.BASE] + low
    if now < state[at.NOW]:
        state[at.BACKWARDS] += 1
        return state[at.NOW]
    state[at.NOW] = now
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
    if state[at.HIGH] < 0:
        return state[at.NOW]
    now = state[at.BASE] + low
    if now < state[at.NOW]:
        if state[at.EVENTS_BEFORE] != events or now < state[at.EARLIER]:
            state[at.BACKWARDS] += 1
            return state[at.NOW]
        state[at.GLITCH] += 1
    else:
        state[at.EARLIER] = state[at.NOW]
    state[at.EVENTS_BEFORE] = events
    state[at.NOW] = now
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


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view that is not to be written.

    Bytes of a file are such, bytes put together are not: a kernel that takes both is compiled
    twice, the second time within a stream.
    """
    view = array.view()
    view.flags.writeable = False
    return view


class WordDecoder:
    """A word format's decoder: one kernel for sound words, and what salvage needs to know.

    Args:
        size: ``(width, height)``; events outside are dropped and counted.
        continuous: Whether the writer is known to leave no time word out.

    Attributes:
        name: Name of the encoding.
        form: How the format divides the time.
        word: Type of a word on the wire.
        events_per_word: Most events that a word can stand for.
        state: The kernel's state, see above.
        mended: Time words replaced so far.
    """

    UNKNOWN_TYPE = 2
    name: str
    form: WordFormat
    word: np.dtype[Any]
    events_per_word: int

    def __init__(self, size: tuple[int, int], continuous: bool = False) -> None:
        self.state = new_state(size, continuous)
        self.size = size
        self.mended = 0

    def decode(self, words: NDArray[Any], out: Columns) -> int:
        """Decode words into the columns and return the number of events."""
        raise NotImplementedError

    def view(self, words: NDArray[Any]) -> WordView:
        """Return what each word says."""
        raise NotImplementedError

    def heads(self, words: NDArray[Any]) -> NDArray[Any]:
        """Return the part of each word that holds its type."""
        return words

    def suspects(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a suspicion for each byte offset: 0 none, 1 odd, 2 unknown type."""
        length = self.word.itemsize
        if len(data) < length:
            return np.empty(0, np.uint8)
        words = np.ascontiguousarray(sliding_window_view(data, length)).view(self.word).ravel()
        view = self.view(words)
        far = view.is_high & (abs(view.time - self._expected_high(data)) > self.form.far_steps)
        odd = view.outside | view.rare | far
        return np.where(view.unknown, self.UNKNOWN_TYPE, odd).astype(np.uint8)

    def _expected_high(self, data: NDArray[np.uint8]) -> int:
        """Return the upper time that the words of a chunk should be near."""
        if self.state[at.HIGH] >= 0:
            return int(self.state[at.HIGH])
        end = len(data) // self.word.itemsize * self.word.itemsize
        times = time_words(self.view(data[:end].view(self.word))).value
        return int(np.median(times)) if len(times) else 0

    def time_words(self, words: NDArray[Any]) -> TimeWords:
        """Return the upper times (and mend what else can be mended in place)."""
        return time_words(self.view(words))

    def set_time_words(self, words: NDArray[Any], times: TimeWords) -> None:
        """Write mended upper times back into the words."""
        heads = self.heads(words)
        type_bits = 8 * heads.itemsize - 4
        heads[times.position] = (TIME_HIGH << type_bits) | times.value
