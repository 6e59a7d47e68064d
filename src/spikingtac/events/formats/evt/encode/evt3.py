"""Encode events as EVT 3.0 words; the format is described beside its decoder."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.formats.evt.clock import Integer
from spikingtac.events.formats.evt.encode.word_encoder import WordEncoder
from spikingtac.events.formats.evt.evt3_words import (
    ADDR_X,
    ADDR_Y,
    BASE_X,
    TIME_HIGH,
    TIME_HIGH_BITS,
    TIME_LOW,
    TIME_LOW_BITS,
    VECT_8,
    VECT_12,
)

VECTOR_WIDTH_PX = 32
"""Pixels that a base and its 12 + 12 + 8 vectors cover."""

VECTOR_WORDS = 3
REPEAT_BITS = 8
"""The upper time is repeated after 2^8 us, as sensors do: what is lost is found again sooner."""


class Evt3Encoder(WordEncoder):
    """Turns packets into EVT3 words; vectors are used where they take fewer words.

    Time words are written for every 4,096 us, also in silence, as a camera does (and repeated where
    events follow): a reader can tell silence from loss, and wraps are never ambiguous. Vectors are
    complete 12 + 12 + 8 triples.
    """

    name = "evt3"
    time_bits = TIME_LOW_BITS + TIME_HIGH_BITS
    word = np.uint16
    low_bits = TIME_LOW_BITS
    words_per_event = 5
    silence_step = 1
    memory = 5

    def __init__(self) -> None:
        super().__init__(encode_kernel)


@njit(cache=True, nogil=True)
def encode_kernel(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    out: NDArray[np.uint16],
    state: NDArray[np.int64],
) -> Any:
    """Write words to ``out``; ``state`` is (high, low, row, next vector base, its polarity)."""
    n, i = 0, 0
    while i < len(t):
        if t[i] != ((state[0] << 12) | state[1]) or state[1] < 0:
            n = _time_kernel(t[i], out, n, state)
        if y[i] != state[2]:
            state[2] = y[i]
            out[n] = (ADDR_Y << 12) | y[i]
            n += 1
        last, mask = _run_kernel(t, x, y, p, i)
        joined = state[3] == x[i] and state[4] == p[i]
        if last - i > (VECTOR_WORDS if joined else VECTOR_WORDS + 1):
            n = _vector_kernel(x[i], p[i], mask, joined, out, n, state)
            i = last
        else:
            out[n] = (ADDR_X << 12) | (np.int64(p[i]) << 11) | x[i]
            n += 1
            i += 1
    return n


@njit(cache=True, nogil=True)
def _time_kernel(t: Integer, out: NDArray[np.uint16], n: Integer, state: NDArray[np.int64]) -> Any:
    high = t >> 12
    if high != state[0]:
        first = high if state[0] < 0 else state[0] + 1
        for value in range(first, high + 1):
            out[n] = (TIME_HIGH << 12) | (value & 0xFFF)
            n += 1
        state[0] = high
    elif (t & 0xFFF) >> REPEAT_BITS != state[1] >> REPEAT_BITS:
        out[n] = (TIME_HIGH << 12) | (high & 0xFFF)
        n += 1
    state[1] = t & 0xFFF
    out[n] = (TIME_LOW << 12) | state[1]
    return n + 1


@njit(cache=True, nogil=True)
def _run_kernel(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    i: Integer,
) -> tuple[int, Any]:
    """Return the end and the mask of the events that one vector from event ``i`` can hold."""
    mask, last = 1, i + 1
    while (
        last < len(t)
        and x[last] > x[last - 1]
        and x[last] < x[i] + VECTOR_WIDTH_PX
        and y[last] == y[i]
        and t[last] == t[i]
        and p[last] == p[i]
    ):
        mask |= 1 << (np.int64(x[last]) - np.int64(x[i]))
        last += 1
    return last, mask


@njit(cache=True, nogil=True)
def _vector_kernel(
    x: Integer,
    p: Any,
    mask: Integer,
    joined: Any,
    out: NDArray[np.uint16],
    n: Integer,
    state: NDArray[np.int64],
) -> Any:
    if not joined:
        out[n] = (BASE_X << 12) | (np.int64(p) << 11) | x
        n += 1
    out[n] = (VECT_12 << 12) | (mask & 0xFFF)
    out[n + 1] = (VECT_12 << 12) | ((mask >> 12) & 0xFFF)
    out[n + 2] = (VECT_8 << 12) | ((mask >> 24) & 0xFF)
    state[3] = np.int64(x) + VECTOR_WIDTH_PX
    state[4] = np.int64(p)
    return n + VECTOR_WORDS
