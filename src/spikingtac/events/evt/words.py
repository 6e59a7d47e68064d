"""From bytes to events: carry over what is incomplete, decode, and mend only where it is needed."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from spikingtac.events.evt import decode as at
from spikingtac.events.evt import salvage, wire
from spikingtac.events.evt.wire import Wire, Words, time_words
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.packing import Rows
from spikingtac.types import LossCounters

# Unknown or outside words in a chunk from which on the word boundaries are questioned.
ALIGNMENT_SUSPECTS = 4
CARRY_LIMIT_BYTES = 1 << 20  # Most that is held back until a leap of the time is confirmed.
NO_WRAP_BITS = 62  # Bits of a counter that never wraps, as the lower time within an upper one.


class WordStream(Wire):
    """Decodes a stream of words as its bytes come; what is wrong is mended and counted.

    Time, row and vector base are kept from call to call.

    Args:
        name: Encoding, with the byte order of EVT2.1: one of :data:`wire.CANDIDATES`.
        size: ``(width, height)``, px; events outside are dropped and counted.
        losses: Counters to fill.
        triggers: Where trigger edges are appended.
        base_us: Added to the times of events and triggers.
        continuous: Whether the writer is known to leave no time word out.
    """

    def __init__(
        self,
        name: str,
        size: tuple[int, int],
        losses: LossCounters,
        triggers: Triggers,
        base_us: int = 0,
        continuous: bool = False,
    ) -> None:
        super().__init__(name)
        self._size, self._state = size, at.new_state(size, continuous)
        self._losses, self._triggers, self._base_us = losses, triggers, base_us
        self._carry, self._in_fill = np.empty(0, np.uint8), False
        self._out = at.new_columns(0, 0)

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
        words, end = self._whole(buffer)
        if self._in_fill or salvage.may_be_filled(buffer):
            words, begun, self._in_fill = salvage.without_fill(words, self._in_fill)
            self._losses.add("garbage", begun)
            buffer = np.concatenate((words.view(np.uint8), buffer[end:]))
            words, end = self._whole(buffer)
        state, before = self._state, self._state.copy()
        count = self._decode(words)
        misplaced = state[at.UNKNOWN] + state[at.OUTSIDE] >= ALIGNMENT_SUSPECTS
        fallen = state[at.BACKWARDS] + state[at.RESET] + state[at.JUMP]
        if fallen or misplaced or (state[at.UNCONFIRMED] >= 0 and not final):
            state[:] = before
            words, end = self._mended(buffer, bool(misplaced))
            count = self._decode(words)
            held = int(state[at.UNCONFIRMED])
            if not final and held > 0 and len(buffer) < CARRY_LIMIT_BYTES:
                state[:] = before
                count = self._decode(words[:held])
                buffer, end = np.concatenate((words[held:].view(np.uint8), buffer[end:])), 0
        self._carry = np.empty(0, np.uint8) if final else buffer[end:].copy()
        self._losses.add("truncated", int(final and end < len(buffer)))
        return self._taken(count)

    def _whole(self, buffer: NDArray[np.uint8]) -> tuple[Words, int]:
        """Return the whole words in a buffer, and where they end."""
        end = len(buffer) // self.word.itemsize * self.word.itemsize
        return buffer[:end].view(self.word), end

    def _decode(self, words: Words) -> int:
        """Decode words into the columns and return the number of events."""
        needed = len(words) * self.events_per_word
        if len(self._out[0]) < needed or len(self._out[-1]) < len(words):
            self._out = at.new_columns(needed, len(words))
        # Bytes of a file are not to be written, bytes put together are: a kernel that takes both is
        # compiled twice, the second time within a stream.
        given = words.view()
        given.flags.writeable = False
        if self.encoding == "evt21":
            halves = self.halves(given).astype("<u4", copy=False)
            halves.flags.writeable = False
            return at.decode_evt21_kernel(halves, self.upper, self._out, self._state)
        kernel = at.decode_evt2_kernel if self.encoding == "evt2" else at.decode_evt3_kernel
        return kernel(given, self._out, self._state)

    def _mended(self, buffer: NDArray[np.uint8], misaligned: bool) -> tuple[Words, int]:
        whole, end = self._whole(buffer)
        words = whole.copy()
        if misaligned:
            words, end, breaks = salvage.aligned(buffer, self._suspects(buffer), self.word)
            self._losses.add("resynchronised", breaks)
            words, blocks = salvage.without_garbage(words, self.view(words, self._size).unknown)
            self._losses.add("garbage", blocks)
        self._losses.add("time_glitch", self._mend_times(words))
        return words, end

    def _suspects(self, data: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return for each byte offset whether a word that begins there is implausible."""
        if len(data) < self.word.itemsize:
            return np.empty(0, np.bool_)
        near = int(self._state[at.HIGH])  # upper time that the words of a chunk should be near
        if near < 0:
            _, times, _ = time_words(self.view(self._whole(data)[0], self._size))
            near = int(np.median(times)) if len(times) else 0
        every = np.ascontiguousarray(sliding_window_view(data, self.word.itemsize))
        view = self.view(every.view(self.word).ravel(), self._size)
        far = view.is_high & (abs(view.time - near) > self.form.far_steps)
        return view.unknown | view.outside | view.rare | far

    def _mend_times(self, words: Words) -> int:
        """Mend upper times, of EVT3 the lower ones before, in place; return how many."""
        last, mended = int(self._state[at.HIGH]), 0
        position, value, wrapped = time_words(self.view(words, self._size))
        if self.encoding == "evt3":
            units = position[value != np.concatenate(([last], value[:-1]))]
            low = np.flatnonzero(words >> 12 == wire.TIME_LOW)
            for places in np.split(low, np.searchsorted(low, units)):
                lows = (words[places] & 0xFFF).astype(np.int64)
                whole = np.zeros(len(lows), np.bool_)
                mended += int(salvage.mend_high_kernel(lows, whole, at.NONE, NO_WRAP_BITS))
                words[places] = (wire.TIME_LOW << 12) | lows
            position, value, wrapped = time_words(self.view(words, self._size))
        # Where no time falls nothing is mended (a call all the same: the warm-up compiles it).
        told = value if (np.diff(value, prepend=max(last, 0)) < 0).any() else value[:0]
        ends = wrapped[: len(told)]
        mended += int(salvage.mend_high_kernel(told, ends, last, self.form.high_bits))
        self.heads(words)[position] = (wire.TIME_HIGH << self.form.high_bits) | value
        return mended

    def _taken(self, count: int) -> Rows:
        """Pass on what was counted; return the columns."""
        (x, y, p, t, triggers), state = self._out, self._state
        if state[at.TRIGGERS]:
            t_us, channel, edge = triggers[: state[at.TRIGGERS]].T
            self._triggers.append(t_us + self._base_us, channel, edge)
        counters = state[at.FIRST_COUNTER :]
        if counters.any():  # hardly ever: this is asked at every read
            for kind, number in zip(at.COUNTED, counters.tolist(), strict=True):
                self._losses.add(kind, number)
            counters[:] = 0
        times = t[:count] + self._base_us if self._base_us else t[:count]
        return x[:count], y[:count], p[:count], times
