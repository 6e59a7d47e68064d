"""Encode events as EVT 2.1 words; the format is described beside its decoder."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.formats.evt.clock import Integer
from spikingtac.events.formats.evt.encode.word_encoder import WordEncoder
from spikingtac.events.formats.evt.evt2 import (
    SILENCE_STEP,
    TIME_HIGH,
    TIME_HIGH_BITS,
    TIME_LOW_BITS,
)
from spikingtac.events.formats.evt.evt21 import VECTOR_WIDTH_PX


class Evt21Encoder(WordEncoder):
    """Turns packets into little-endian EVT2.1 words with columns aligned on 32, as sensors do."""

    name = "evt21"
    time_bits = TIME_LOW_BITS + TIME_HIGH_BITS
    word = np.uint64
    low_bits = TIME_LOW_BITS
    words_per_event = 2
    silence_step = SILENCE_STEP
    memory = 1

    def __init__(self) -> None:
        super().__init__(encode_kernel)


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
