"""Encode events as EVT 2.1 words; the format is described beside its decoder."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.formats.clock import NONE, Integer
from spikingtac.events.formats.evt2 import SILENCE_STEP, TIME_HIGH, TIME_HIGH_BITS, TIME_LOW_BITS
from spikingtac.events.formats.evt21 import VECTOR_WIDTH_PX


class Evt21Encoder:
    """Turns packets into little-endian EVT2.1 words with columns aligned on 32, as sensors do."""

    name = "evt21"
    time_bits = TIME_LOW_BITS + TIME_HIGH_BITS

    def __init__(self) -> None:
        self._state = np.full(1, NONE, np.int64)

    def encode(
        self,
        t: NDArray[np.int64],
        x: NDArray[np.uint16],
        y: NDArray[np.uint16],
        p: NDArray[np.bool_],
    ) -> NDArray[np.uint64]:
        """Return the words for events in order of time (``t`` counted from the file's base)."""
        if not len(t):
            return np.empty(0, np.uint64)
        first = int(t[0] >> TIME_LOW_BITS) if self._state[0] == NONE else int(self._state[0])
        silence = int(t[-1] >> TIME_LOW_BITS) - first
        words = np.empty(2 * len(t) + silence // SILENCE_STEP + 1, np.uint64)
        return words[: encode_kernel(t, x, y, p, words, self._state)]


@njit(cache=True, nogil=True)
def encode_kernel(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    out: NDArray[np.uint64],
    state: NDArray[np.int64],
) -> Any:
    """Write words to ``out`` and return their number; ``state`` is (time high)."""
    n, i = 0, 0
    while i < len(t):
        high = t[i] >> TIME_LOW_BITS
        if high != state[0]:
            n = _lead_kernel(high, out, n, state)
        column = np.int64(x[i]) & ~31
        mask = np.int64(1) << (np.int64(x[i]) - column)
        last = i + 1
        while (
            last < len(t)
            and x[last] > x[last - 1]
            and x[last] < column + VECTOR_WIDTH_PX
            and y[last] == y[i]
            and t[last] == t[i]
            and p[last] == p[i]
        ):
            mask |= np.int64(1) << (np.int64(x[last]) - column)
            last += 1
        head = (np.int64(p[i]) << 28) | ((t[i] & 0x3F) << 22) | (column << 11) | np.int64(y[i])
        out[n] = (np.uint64(head) << np.uint64(32)) | np.uint64(mask)
        n += 1
        i = last
    return n


@njit(cache=True, nogil=True)
def _lead_kernel(
    high: Integer, out: NDArray[np.uint64], n: Integer, state: NDArray[np.int64]
) -> Any:
    first = state[0] + SILENCE_STEP if state[0] >= 0 else high
    for value in range(first, high, SILENCE_STEP):
        out[n] = np.uint64((TIME_HIGH << 28) | (value & 0xFFFFFFF)) << np.uint64(32)
        n += 1
    out[n] = np.uint64((TIME_HIGH << 28) | (high & 0xFFFFFFF)) << np.uint64(32)
    state[0] = high
    return n + 1
