"""From bytes to events: carry over what is incomplete, decode, and mend only where it is needed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from spikingtac.events.evt import decoder as at
from spikingtac.events.evt import salvage, wire
from spikingtac.events.evt.decoder import Columns, new_state
from spikingtac.events.evt.decoders import (
    decode_evt2_kernel,
    decode_evt3_kernel,
    decode_evt21_kernel,
)
from spikingtac.events.evt.salvage import may_be_filled, mend_high_kernel, without_fill
from spikingtac.events.evt.wire import Wire, time_words
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.packing import Rows
from spikingtac.types import LossCounters

Words = NDArray[Any]
# Unknown or outside words in a chunk from which on the word boundaries are questioned.
ALIGNMENT_SUSPECTS = 4
CARRY_LIMIT_BYTES = 1 << 20  # Most that is held back until a leap of the time is confirmed.


NO_WRAP_BITS = 62  # Bits of a counter that never wraps, as the lower time within an upper one.


class WordDecoder(Wire):
    """Decodes the words of one format; keeps time, row and vector base from call to call.

    Args:
        encoding: ``evt2``, ``evt21`` or ``evt3``.
        size: ``(width, height)``, px; events outside are dropped and counted.
        byte_order: Of EVT2.1 words: ``little``, ``legacy`` or ``big``.
        continuous: Whether the writer is known to leave no time word out.

    Attributes:
        state: The kernels' state, see :mod:`spikingtac.events.evt.decoder`.
    """

    def __init__(
        self,
        encoding: str,
        size: tuple[int, int],
        byte_order: str = "little",
        continuous: bool = False,
    ) -> None:
        super().__init__(f"{encoding}/{byte_order}")
        self._size, self.state = size, new_state(size, continuous)

    def decode(self, words: Words, out: Columns) -> int:
        """Decode words into the columns and return the number of events."""
        if self.encoding == "evt21":
            halves = self.halves(words).astype("<u4", copy=False)
            return decode_evt21_kernel(_read_only(halves), self.upper, out, self.state)
        kernel = decode_evt2_kernel if self.encoding == "evt2" else decode_evt3_kernel
        return kernel(_read_only(words), out, self.state)

    def suspects(self, data: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return for each byte offset whether a word that begins there is implausible."""
        length = self.word.itemsize
        if len(data) < length:
            return np.empty(0, np.bool_)
        near = int(self.state[at.HIGH])  # upper time that the words of a chunk should be near
        if near < 0:
            times = time_words(
                self.view(data[: len(data) // length * length].view(self.word), self._size)
            )
            near = int(np.median(times.value)) if len(times.value) else 0
        words = np.ascontiguousarray(sliding_window_view(data, length)).view(self.word).ravel()
        view = self.view(words, self._size)
        far = view.is_high & (abs(view.time - near) > self.form.far_steps)
        return view.unknown | view.outside | view.rare | far

    def undefined(self, words: Words) -> NDArray[np.bool_]:
        """Return which words are of no type that the format defines."""
        return self.view(words, self._size).unknown

    def mend_times(self, words: Words) -> int:
        """Mend upper times, of EVT3 the lower ones before, in place; return how many."""
        times, mended = time_words(self.view(words, self._size)), 0
        last = int(self.state[at.HIGH])
        if self.encoding == "evt3":
            units = times.position[times.value != np.concatenate(([last], times.value[:-1]))]
            low = np.flatnonzero(words >> 12 == wire.TIME_LOW)
            for places in np.split(low, np.searchsorted(low, units)):
                value = (words[places] & 0xFFF).astype(np.int64)
                whole = np.zeros(len(value), np.bool_)
                mended += int(mend_high_kernel(value, whole, at.NONE, NO_WRAP_BITS))
                words[places] = (wire.TIME_LOW << 12) | value
            times = time_words(self.view(words, self._size))
        mended += int(mend_high_kernel(times.value, times.wrapped, last, self.form.high_bits))
        heads = self.heads(words)
        heads[times.position] = (wire.TIME_HIGH << (8 * heads.itemsize - 4)) | times.value
        return mended


def _read_only(array: Words) -> Words:
    """Return a view that is not to be written.

    Bytes of a file are such, bytes put together are not: a kernel that takes both is compiled
    twice, the second time within a stream.
    """
    view = array.view()
    view.flags.writeable = False
    return view


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
            words, blocks = salvage.without_garbage(words, decoder.undefined(words))
            self._losses.add("garbage", blocks)
        self._losses.add("time_glitch", decoder.mend_times(words))
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
