"""From bytes to events: carry over what is incomplete, decode, and mend only where it is needed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.evt import decoder as at
from spikingtac.events.evt import salvage
from spikingtac.events.evt.decoder import Columns, WordDecoder
from spikingtac.events.evt.salvage import may_be_filled, without_fill
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.packing import Rows
from spikingtac.types import LossCounters

# Unknown or outside words in a chunk from which on the word boundaries are questioned.
ALIGNMENT_SUSPECTS = 4

CARRY_LIMIT_BYTES = 1 << 20  # Most that is held back until a leap of the time is confirmed.


class WordStream:
    """Feeds bytes to a decoder; what is wrong is mended and counted.

    Args:
        decoder: Decoder of one word format.
        losses: Counters to fill.
        triggers: Where trigger edges are appended.
        base_us: Added to the times of events and triggers.
    """

    def __init__(
        self, decoder: WordDecoder, losses: LossCounters, triggers: Triggers, base_us: int = 0
    ) -> None:
        self._decoder, self._base_us = decoder, base_us
        self._losses, self._triggers = losses, triggers
        self._carry, self._in_fill = np.empty(0, np.uint8), False
        self._out = Columns.empty(0, 0)

    def feed(self, data: bytes | memoryview, final: bool = False) -> Rows:
        """Return the columns x, y, p and t of the events in the next bytes.

        They are views of buffers that the next call overwrites.

        Args:
            data: Bytes that follow the ones before.
            final: Whether nothing follows: incomplete words are counted, not carried over.
        """
        buffer = np.frombuffer(data, np.uint8)
        if len(self._carry):
            buffer = np.concatenate((self._carry, buffer))
        decoder = self._decoder
        end = len(buffer) // decoder.word.itemsize * decoder.word.itemsize
        if self._in_fill or may_be_filled(buffer):
            whole = buffer[:end].view(decoder.word)
            words, begun, self._in_fill = without_fill(whole, self._in_fill)
            self._losses.add("garbage", begun)
            buffer = np.concatenate((words.view(np.uint8), buffer[end:]))
            end = len(words) * decoder.word.itemsize
        words = buffer[:end].view(decoder.word)
        state, before = decoder.state, decoder.state.copy()
        count = self._decode(words)
        misplaced = state[at.UNKNOWN] + state[at.OUTSIDE] >= ALIGNMENT_SUSPECTS
        fallen = state[at.BACKWARDS] + state[at.RESET] + state[at.JUMP]
        if fallen or misplaced or (state[at.UNCONFIRMED] >= 0 and not final):
            decoder.state[:] = before
            words, end = self._mended(buffer, bool(misplaced))
            count = self._decode(words)
            held = int(decoder.state[at.UNCONFIRMED])
            if not final and held > 0 and len(buffer) < CARRY_LIMIT_BYTES:
                decoder.state[:] = before
                count = self._decode(words[:held])
                tail = words[held:].view(np.uint8)
                buffer, end = np.concatenate((tail, buffer[end:])), 0
        self._carry = np.empty(0, np.uint8) if final else buffer[end:].copy()
        self._losses.add("truncated", int(final and end < len(buffer)))
        return self._taken(count)

    def _decode(self, words: NDArray[Any]) -> int:
        needed = len(words) * self._decoder.events_per_word
        if len(self._out.x) < needed or len(self._out.triggers) < len(words):
            self._out = Columns.empty(needed, len(words))
        return self._decoder.decode(words, self._out)

    def _mended(self, buffer: NDArray[np.uint8], misaligned: bool) -> tuple[NDArray[Any], int]:
        decoder = self._decoder
        end = len(buffer) // decoder.word.itemsize * decoder.word.itemsize
        words = buffer[:end].view(decoder.word).copy()
        if misaligned:
            words, end, breaks = salvage.aligned(buffer, decoder.suspects(buffer), decoder.word)
            self._losses.add("resynchronised", breaks)
            words, blocks = salvage.without_garbage(words, decoder.view(words).unknown)
            self._losses.add("garbage", blocks)
        times = decoder.time_words(words)
        last = int(decoder.state[at.HIGH])
        mended = salvage.mend_high_kernel(times.value, times.wrapped, last, decoder.form.high_bits)
        decoder.set_time_words(words, times)
        self._losses.add("time_glitch", int(mended) + decoder.mended)
        decoder.mended = 0
        return words, end

    def _taken(self, count: int) -> Rows:
        out, state = self._out, self._decoder.state
        if state[at.TRIGGERS]:
            t_us, channel, edge = out.triggers[: state[at.TRIGGERS]].T
            self._triggers.append(t_us + self._base_us, channel, edge)
        counters = state[at.FIRST_COUNTER :]
        if counters.any():  # hardly ever: this is asked at every read
            for kind, number in zip(at.COUNTED, counters.tolist(), strict=True):
                self._losses.add(kind, number)
            counters[:] = 0
        t = out.t[:count] + self._base_us if self._base_us else out.t[:count]
        return out.x[:count], out.y[:count], out.p[:count], t
