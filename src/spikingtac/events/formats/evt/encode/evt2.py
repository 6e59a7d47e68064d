"""Encode events as EVT 2.0 words; the format is described beside its decoder."""

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


class Evt2Encoder(WordEncoder):
    """Turns packets into EVT2 words."""

    name = "evt2"
    time_bits = TIME_LOW_BITS + TIME_HIGH_BITS
    word = np.uint32
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
