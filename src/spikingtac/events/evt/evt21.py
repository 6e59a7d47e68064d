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

from spikingtac.events.evt import fields as at
from spikingtac.events.evt import wire
from spikingtac.events.evt.decoder import (
    Columns,
    Integer,
    WordDecoder,
    read_only,
    time_high_kernel,
    time_low_kernel,
)
from spikingtac.events.evt.evt2 import HIGH_BITS, LOW_BITS, rare_kernel
from spikingtac.events.evt.wire import EVT2, WordView, view_evt2

# Index of the lowest set bit of each 16-bit mask.
LOWEST_BIT = np.array([0] + [(m & -m).bit_length() - 1 for m in range(1, 1 << 16)], np.uint8)


class Evt21Decoder(WordDecoder):
    """Turns EVT2.1 words into events; keeps the upper time from call to call.

    Args:
        size: ``(width, height)``; events outside are dropped and counted.
        continuous: Whether the writer is known to leave no time word out.
        byte_order: ``little``, ``legacy`` or ``big``.
    """

    name = "evt21"
    form = EVT2
    events_per_word = wire.VECTOR_WIDTH_PX

    def __init__(
        self, size: tuple[int, int], continuous: bool = False, byte_order: str = "little"
    ) -> None:
        super().__init__(size, continuous)
        self.word = np.dtype(">u8" if byte_order == "big" else "<u8")
        self._half = np.dtype(">u4" if byte_order == "big" else "<u4")
        self._head = 1 if byte_order == "little" else 0

    def decode(self, words: NDArray[Any], out: Columns) -> int:
        """Decode words into the columns and return the number of events."""
        halves = self._halves(words).astype("<u4", copy=False)
        return decode_kernel(read_only(halves), self._head, out, self.state)

    def view(self, words: NDArray[Any]) -> WordView:
        """Return what each word says."""
        halves = self._halves(words)
        return view_evt2(halves[:, self._head], halves[:, 1 - self._head], self.size)

    def heads(self, words: NDArray[Any]) -> NDArray[Any]:
        """Return the upper half of each word."""
        return self._halves(words)[:, self._head]

    def _halves(self, words: NDArray[Any]) -> NDArray[Any]:
        return words.view(self._half).reshape(-1, 2)


@njit(cache=True, nogil=True)
def decode_kernel(
    halves: NDArray[np.uint32], upper: int, out: Columns, state: NDArray[np.int64]
) -> Any:
    """Decode words, ``(n, 2)`` halves, the upper in column ``upper``; return the event count."""
    x, y, p, t, triggers = out
    n = 0
    for i in range(len(halves)):
        head = np.int64(halves[i, upper])
        kind = head >> 28
        if kind <= wire.EVENT_ON:
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
        elif kind == wire.TIME_HIGH:
            time_high_kernel(state, head & 0xFFFFFFF, LOW_BITS, HIGH_BITS, i)
        else:
            rare_kernel(head, triggers, state)
    return n


@njit(cache=True, nogil=True)
def _visible_kernel(head: Integer, mask: Integer, state: NDArray[np.int64]) -> Any:
    """Return the part of the mask that lies on the sensor; count the rest."""
    column, row = (head >> 11) & 0x7FF, head & 0x7FF
    timed = state[at.HIGH] >= 0
    if timed and column + wire.VECTOR_WIDTH_PX <= state[at.WIDTH] and row < state[at.HEIGHT]:
        return mask
    room = min(max(state[at.WIDTH] - column, 0), wire.VECTOR_WIDTH_PX)
    kept = mask & ((np.int64(1) << room) - 1) if timed and row < state[at.HEIGHT] else np.int64(0)
    lost = mask & ~kept
    while lost:
        state[at.OUTSIDE if timed else at.MISSING] += 1
        lost &= lost - 1
    return kept
