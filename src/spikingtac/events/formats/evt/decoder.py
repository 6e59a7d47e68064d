"""What the three RAW word formats share: columns, time words and the decoder's shape."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.evt import clock


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


class TimeWords(NamedTuple):
    """The words of upper time in a chunk.

    Attributes:
        position: Index of each among the words.
        value: What each says.
        wrapped: Whether the lower time fell from before it to after it, so that a step is due.
    """

    position: NDArray[np.int64]
    value: NDArray[np.int64]
    wrapped: NDArray[np.bool_]

    @classmethod
    def empty(cls, length: int) -> Self:
        """Return room for ``length`` words."""
        return cls(np.empty(length, np.int64), np.empty(length, np.int64), np.empty(length, bool))

    def first(self, count: int) -> TimeWords:
        """Return the first ``count`` of them."""
        return TimeWords(self.position[:count], self.value[:count], self.wrapped[:count])


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
        word: Type of a word on the wire.
        events_per_word: Most events that a word can stand for.
        low_bits: Bits of the lower time.
        high_bits: Bits of the upper time.
        state: The kernel's state, see :mod:`spikingtac.events.formats.evt.clock`.
        mended: Time words replaced so far.
    """

    UNKNOWN_TYPE = 2
    name: str
    word: np.dtype[Any]
    events_per_word: int
    low_bits: int
    high_bits: int

    def __init__(self, size: tuple[int, int], continuous: bool = False) -> None:
        self.state = clock.new_state(size, continuous)
        self.mended = 0

    def decode(self, words: NDArray[Any], out: Columns) -> int:
        """Decode words into the columns and return the number of events."""
        raise NotImplementedError

    def suspects(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a suspicion for each byte offset: 0 none, 1 odd, 2 unknown type."""
        raise NotImplementedError

    def expected_high(self, data: NDArray[np.uint8]) -> int:
        """Return the upper time that the words of a chunk should be near."""
        if self.state[clock.HIGH] >= 0:
            return int(self.state[clock.HIGH])
        end = len(data) // self.word.itemsize * self.word.itemsize
        times = self.time_words(data[:end].view(self.word).copy()).value
        return int(np.median(times)) if len(times) else 0

    def time_words(self, words: NDArray[Any]) -> TimeWords:
        """Return the upper times (and mend what else can be mended in place)."""
        raise NotImplementedError

    def set_time_words(self, words: NDArray[Any], times: TimeWords) -> None:
        """Write mended upper times back into the words."""
        raise NotImplementedError
