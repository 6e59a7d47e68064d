"""Encode events as EVT 2.0 words; the format is described beside its decoder."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.formats.clock import NONE, Integer
from spikingtac.events.formats.evt2 import SILENCE_STEP, TIME_HIGH, TIME_HIGH_BITS, TIME_LOW_BITS


class Evt2Encoder:
    """Turns packets into EVT2 words."""

    name = "evt2"
    time_bits = TIME_LOW_BITS + TIME_HIGH_BITS

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
) -> Any:
    """Write words to ``out`` and return their number; ``state`` is (time high)."""
    n = 0
    for i in range(len(t)):
        high = t[i] >> TIME_LOW_BITS
        if high != state[0]:
            n = _lead_kernel(high, out, n, state)
        address = (np.int64(x[i]) << 11) | np.int64(y[i])
        out[n] = (np.int64(p[i]) << 28) | ((t[i] & 0x3F) << 22) | address
        n += 1
    return n


@njit(cache=True, nogil=True)
def _lead_kernel(
    high: Integer, out: NDArray[np.uint32], n: Integer, state: NDArray[np.int64]
) -> Any:
    """Write the time words that lead to ``high``, a few of them for a long silence."""
    if state[0] >= 0:
        for value in range(state[0] + SILENCE_STEP, high, SILENCE_STEP):
            out[n] = (TIME_HIGH << 28) | (value & 0xFFFFFFF)
            n += 1
    out[n] = (TIME_HIGH << 28) | (high & 0xFFFFFFF)
    state[0] = high
    return n + 1
