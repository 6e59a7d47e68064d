"""What the three RAW encoders share: packets in, words out, and what a camera would remember."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.evt.clock import NONE


class WordEncoder:
    """Turns packets of one stream into words.

    Attributes:
        name: Of the encoding, as in a file's header.
        time_bits: Of the counter on the wire, us.
        word: Type of a word.
        low_bits: Bits of the time that a word of an event carries.
        words_per_event: At most, time words for it included.
        silence_step: At most so many upper times pass between two time words.
        memory: Numbers that the kernel keeps from packet to packet; the first is the upper time.
    """

    name: str
    time_bits: int
    word: type[np.unsignedinteger[Any]]
    low_bits: int
    words_per_event: int
    silence_step: int
    memory: int

    def __init__(self, kernel: Callable[..., int]) -> None:
        """Begin a stream.

        Args:
            kernel: Writes the words of events ``(t, x, y, p, out, state)``; returns their number.
        """
        self._kernel = kernel
        self._state = np.full(self.memory, NONE, np.int64)

    def encode(
        self,
        t: NDArray[np.int64],
        x: NDArray[np.uint16],
        y: NDArray[np.uint16],
        p: NDArray[np.bool_],
    ) -> NDArray[Any]:
        """Return the words for events in order of time (``t`` counted from the file's base)."""
        if not len(t):
            return np.empty(0, self.word)
        known = int(self._state[0])
        first = int(t[0] >> self.low_bits) if known == NONE else known
        silence = int(t[-1] >> self.low_bits) - first
        room = self.words_per_event * len(t) + silence // self.silence_step + 1
        words = np.empty(room, self.word)
        return words[: self._kernel(t, x, y, p, words, self._state)]
