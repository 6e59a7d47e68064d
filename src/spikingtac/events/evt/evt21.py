"""EVT 2.1: 64-bit words; an event word holds up to 32 pixels of one row, time and polarity.

Source: Prophesee, "EVT 2.1 Format" (public documentation). The upper half of a word is an EVT2
word, whose column is that of the first pixel; the lower half is the mask of the pixels with an
event. Words come in three byte orders: ``little`` (GenX320; the format's default), ``legacy``
(IMX636 and older: the upper half first, each half little-endian) and ``big``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.evt.decoder import (
    HEIGHT,
    HIGH,
    MISSING,
    OUTSIDE,
    WIDTH,
    Columns,
    Integer,
    TimeWords,
    WordDecoder,
    read_only,
    time_high_kernel,
    time_low_kernel,
)
from spikingtac.events.evt.evt2 import (
    EVENT_ON,
    PADDING,
    TIME_HIGH,
    TIME_HIGH_BITS,
    TIME_LOW_BITS,
    rare_kernel,
    suspect_kernel,
    time_words_kernel,
)

BYTE_ORDERS = ("little", "legacy", "big")
VECTOR_WIDTH_PX = 32
LOWEST_BIT = np.array([0] + [(m & -m).bit_length() - 1 for m in range(1, 1 << 16)], np.uint8)
"""Index of the lowest set bit of each 16-bit mask."""


class Evt21Decoder(WordDecoder):
    """Turns EVT2.1 words into events; keeps the upper time from call to call.

    Args:
        size: ``(width, height)``; events outside are dropped and counted.
        continuous: Whether the writer is known to leave no time word out.
        byte_order: ``little``, ``legacy`` or ``big``.
    """

    name = "evt21"
    events_per_word = VECTOR_WIDTH_PX
    low_bits = TIME_LOW_BITS
    high_bits = TIME_HIGH_BITS

    def __init__(
        self, size: tuple[int, int], continuous: bool = False, byte_order: str = "little"
    ) -> None:
        super().__init__(size, continuous)
        self.word = np.dtype(">u8" if byte_order == "big" else "<u8")
        half = "<u4" if byte_order != "big" else ">u4"
        self._half = np.dtype(half)
        self._head = 1 if byte_order == "little" else 0

    def decode(self, words: NDArray[Any], out: Columns) -> int:
        """Decode words into the columns and return the number of events."""
        return decode_kernel(read_only(self._halves(words)), self._head, *out, self.state)

    def suspects(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a suspicion for each byte offset: 0 none, 1 odd, 2 unknown type."""
        out = np.empty(max(len(data) - 7, 0), np.uint8)
        little = self._half.str[0] == "<"
        high = self.expected_high(data)
        suspects_kernel(read_only(data), 4 * self._head, little, high, out, self.state)
        return out

    def time_words(self, words: NDArray[Any]) -> TimeWords:
        """Return the upper times."""
        out = TimeWords.empty(len(words))
        return out.first(time_words_kernel(self._halves(words)[:, self._head], *out))

    def set_time_words(self, words: NDArray[Any], times: TimeWords) -> None:
        """Write mended upper times back into the words."""
        halves = words.view(self._half).reshape(-1, 2)
        halves[times.position, self._head] = (TIME_HIGH << 28) | times.value

    def _halves(self, words: NDArray[Any]) -> NDArray[np.uint32]:
        return words.view(self._half).reshape(-1, 2).astype("<u4", copy=False)


@njit(cache=True, nogil=True)
def decode_kernel(
    halves: NDArray[np.uint32],
    upper: int,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    t: NDArray[np.int64],
    triggers: NDArray[np.int64],
    state: NDArray[np.int64],
) -> Any:
    """Decode words, ``(n, 2)`` halves, the upper in column ``upper``; return the event count."""
    n = 0
    for i in range(len(halves)):
        head = np.int64(halves[i, upper])
        kind = head >> 28
        if kind <= EVENT_ON:
            mask = _visible_kernel(head, np.int64(halves[i, 1 - upper]), state)
            if not mask:
                continue
            now = time_low_kernel(state, (head >> 22) & 0x3F)
            column, row = (head >> 11) & 0x7FF, head & 0x7FF
            for _half in range(2):
                bits = mask & 0xFFFF
                while bits:
                    x[n], y[n], p[n], t[n] = column + LOWEST_BIT[bits], row, kind, now
                    bits &= bits - 1
                    n += 1
                mask >>= 16
                column += 16
        elif kind == TIME_HIGH:
            time_high_kernel(state, head & 0xFFFFFFF, TIME_LOW_BITS, TIME_HIGH_BITS, i)
        else:
            rare_kernel(head, PADDING, triggers, state)
    return n


@njit(cache=True, nogil=True)
def _visible_kernel(head: Integer, mask: Integer, state: NDArray[np.int64]) -> Any:
    """Return the part of the mask that lies on the sensor; count the rest."""
    column, row = (head >> 11) & 0x7FF, head & 0x7FF
    timed = state[HIGH] >= 0
    if timed and column + VECTOR_WIDTH_PX <= state[WIDTH] and row < state[HEIGHT]:
        return mask
    room = min(max(state[WIDTH] - column, 0), VECTOR_WIDTH_PX)
    kept = mask & ((np.int64(1) << room) - 1) if timed and row < state[HEIGHT] else np.int64(0)
    lost = mask & ~kept
    while lost:
        state[OUTSIDE if timed else MISSING] += 1
        lost &= lost - 1
    return kept


@njit(cache=True, nogil=True)
def suspects_kernel(
    data: NDArray[np.uint8],
    head_offset: Integer,
    little: bool,
    high: Integer,
    out: NDArray[np.uint8],
    state: NDArray[np.int64],
) -> None:
    """Mark for each byte offset what is wrong with the word that begins there."""
    for i in range(len(out)):
        head = np.int64(0)
        for k in range(4):
            shift = 8 * k if little else 24 - 8 * k
            head |= np.int64(data[i + head_offset + k]) << shift
        out[i] = suspect_kernel(head, high, state)
        mask = 0
        for k in range(4):
            mask |= data[i + 4 - head_offset + k]
        if head >> 28 <= EVENT_ON and mask == 0:
            out[i] = 1
