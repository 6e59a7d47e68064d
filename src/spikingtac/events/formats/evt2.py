"""EVT 2.0: 32-bit words, one event each; the upper 28 bits of the time come in words of their own.

Source: Prophesee, "EVT 2.0 Format" (public documentation). A word's upper four bits are its type:
0 OFF event, 1 ON event, 8 time, 10 trigger, 14 and 15 vendor extensions.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

EVENT_OFF, EVENT_ON, TIME_HIGH, TRIGGER, OTHERS, CONTINUED = 0x0, 0x1, 0x8, 0xA, 0xE, 0xF
TIME_LOW_BITS = 6
TIME_BITS = 34
SILENCE_STEP = 1 << 10
"""Time words in silence: one for each 65,536 us."""

NONE = -1


class Evt2Encoder:
    """Turns packets into EVT2 words."""

    name = "evt2"
    time_bits = TIME_BITS

    def __init__(self) -> None:
        self._state = np.full(1, NONE, np.int64)

    def encode(
        self,
        t: NDArray[np.int64],
        x: NDArray[np.uint16],
        y: NDArray[np.uint16],
        p: NDArray[np.bool_],
    ) -> NDArray[np.uint32]:
        """Return the words for events in order of time (``t`` counted from the file's base)."""
        if not len(t):
            return np.empty(0, np.uint32)
        first = int(t[0] >> TIME_LOW_BITS) if self._state[0] == NONE else int(self._state[0])
        silence = int(t[-1] >> TIME_LOW_BITS) - first
        words = np.empty(2 * len(t) + silence // SILENCE_STEP + 1, np.uint32)
        return words[: encode_kernel(t, x, y, p, words, self._state)]


@njit(cache=True, nogil=True)
def encode_kernel(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    out: NDArray[np.uint32],
    state: NDArray[np.int64],
) -> int:
    """Write words to ``out`` and return their number; ``state`` is (time high)."""
    n = 0
    for i in range(len(t)):
        high = t[i] >> TIME_LOW_BITS
        if high != state[0]:
            n = time_words_kernel(high, out, n, state)
        address = (np.int64(x[i]) << 11) | np.int64(y[i])
        out[n] = (np.int64(p[i]) << 28) | ((t[i] & 0x3F) << 22) | address
        n += 1
    return n


@njit(cache=True, nogil=True)
def time_words_kernel(high: int, out: NDArray[np.uint32], n: int, state: NDArray[np.int64]) -> int:
    """Write the time words that lead to ``high``, a few of them for a long silence."""
    if state[0] >= 0:
        for value in range(state[0] + SILENCE_STEP, high, SILENCE_STEP):
            out[n] = (TIME_HIGH << 28) | (value & 0xFFFFFFF)
            n += 1
    out[n] = (TIME_HIGH << 28) | (high & 0xFFFFFFF)
    state[0] = high
    return n + 1
