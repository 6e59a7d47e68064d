"""EVT 2.0: 32-bit words, one event each; the upper 28 bits of the time come in words of their own.

Source: Prophesee, "EVT 2.0 Format" (public documentation). Counted from the top, an event's word
holds its type (4 bits: 0 OFF, 1 ON), the lower time (6), the column (11) and the row (11). Other
types: 8 upper time, 10 trigger, 13 to 15 vendor extensions.
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
from spikingtac.events.evt.wire import EVT2, WordView, view_evt2

LOW_BITS, HIGH_BITS, KNOWN_TYPES = EVT2.low_bits, EVT2.high_bits, EVT2.known_types


class Evt2Decoder(WordDecoder):
    """Turns EVT2 words into events; keeps the upper time from call to call."""

    name = "evt2"
    form = EVT2
    word = np.dtype("<u4")
    events_per_word = 1

    def decode(self, words: NDArray[Any], out: Columns) -> int:
        """Decode words into the columns and return the number of events."""
        return decode_kernel(read_only(words), out, self.state)

    def view(self, words: NDArray[Any]) -> WordView:
        """Return what each word says."""
        return view_evt2(words, None, self.size)


@njit(cache=True, nogil=True)
def decode_kernel(words: NDArray[np.uint32], out: Columns, state: NDArray[np.int64]) -> Any:
    """Decode words into the columns; return the number of events."""
    x, y, p, t, triggers = out
    width, height = state[at.WIDTH], state[at.HEIGHT]
    n, base, now = 0, state[at.BASE], state[at.NOW]
    for i in range(len(words)):
        word = np.int64(words[i])
        kind = word >> 28
        if kind <= wire.EVENT_ON:
            column, row = (word >> 11) & 0x7FF, word & 0x7FF
            if now >= 0 and column < width and row < height:
                stamped = base + ((word >> 22) & 0x3F)
                if stamped >= now:
                    now = stamped
                else:
                    state[at.BACKWARDS] += 1
                x[n], y[n], p[n], t[n] = column, row, kind, now
                n += 1
            else:
                state[at.OUTSIDE if now >= 0 else at.MISSING] += 1
        else:
            state[at.NOW] = now
            if kind == wire.TIME_HIGH:
                time_high_kernel(state, word & 0xFFFFFFF, LOW_BITS, HIGH_BITS, i)
            else:
                rare_kernel(word, triggers, state)
            base, now = state[at.BASE], state[at.NOW]
    state[at.NOW] = now
    return n


@njit(cache=True, nogil=True)
def rare_kernel(word: Integer, triggers: NDArray[np.int64], state: NDArray[np.int64]) -> None:
    """Take a 32-bit word (of EVT2, or the upper half of one of EVT2.1) that is no event."""
    kind = word >> 28
    if kind == wire.TRIGGER:
        if state[at.HIGH] >= 0:
            triggers[state[at.TRIGGERS], 0] = time_low_kernel(state, (word >> 22) & 0x3F)
            triggers[state[at.TRIGGERS], 1] = (word >> 8) & 0x1F
            triggers[state[at.TRIGGERS], 2] = word & 1
            state[at.TRIGGERS] += 1
    elif word == wire.EVT2_PADDING:
        state[at.PADDINGS] += 1
    elif (KNOWN_TYPES >> kind) & 1:
        state[at.VENDOR] += 1
    else:
        state[at.UNKNOWN] += 1
