"""Encode events as RAW words; the formats are described beside their decoders."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.evt import wire
from spikingtac.events.evt.decode import NONE, Integer
from spikingtac.events.evt.wire import EVT2, EVT3

VECTOR_WORDS = 3

# The upper time is repeated after 2^8 us, as sensors do: what is lost is found again sooner.
REPEAT_BITS = 8

# Upper times that one time word of EVT2 stands for in silence: there is one in 65,536 us.
SILENCE_STEP = 1 << 10
EVT3_WORDS = 5  # Most words that an event of EVT3 takes.

Times = NDArray[np.int64]
Pixels = NDArray[np.uint16]
Signs = NDArray[np.bool_]


class Evt2Encoder:
    """Turns packets of one stream into EVT2 words.

    Attributes:
        name: Of the encoding, as in a file's header.
        form: How the format divides the time.
        word: Type of a word.
    """

    name, form, word = "evt2", EVT2, np.dtype(np.uint32)
    _shift = 0  # bits from the head of a word to its lower end

    def __init__(self) -> None:
        self._high = NONE

    def encode(self, t: Times, x: Pixels, y: Pixels, p: Signs) -> NDArray[Any]:
        """Return the words for events in order of time (``t`` counted from the file's base)."""
        address = x.astype(np.int64) << 11 | y
        return self._with_times(t, p.astype(np.int64) << 28 | (t & 0x3F) << 22 | address)

    def trigger(self, t_us: int, channel: int, rising: bool) -> NDArray[Any]:
        """Return the words for a trigger edge that follows what was encoded before."""
        head = wire.TRIGGER << 28 | (t_us & 0x3F) << 22 | channel << 8 | int(rising)
        return self._with_times(np.array([t_us]), np.array([head << self._shift]).astype(self.word))

    def _with_times(self, t: Times, words: NDArray[Any]) -> NDArray[Any]:
        """Put time words before the events whose upper time is new, a few for a long silence."""
        if not len(t):
            return np.empty(0, self.word)
        high = t >> EVT2.low_bits
        before = np.concatenate(([self._high], high[:-1]))
        new = np.flatnonzero(high != before)
        steps = np.where(before[new] == NONE, 1, high[new] - before[new])
        counts = (steps - 1) // SILENCE_STEP + 1
        number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + 1
        times = np.repeat(before[new], counts) + number * SILENCE_STEP
        times = np.where(number == np.repeat(counts, counts), np.repeat(high[new], counts), times)
        heads = (wire.TIME_HIGH << 28 | times & 0xFFFFFFF).astype(self.word)
        self._high = int(high[-1])
        return np.insert(
            words.astype(self.word), np.repeat(new, counts), heads << self.word.type(self._shift)
        )


class Evt21Encoder(Evt2Encoder):
    """Turns packets into little-endian EVT2.1 words with columns aligned on 32, as sensors do."""

    name, word = "evt21", np.dtype(np.uint64)
    _shift = 32

    def encode(self, t: Times, x: Pixels, y: Pixels, p: Signs) -> NDArray[Any]:
        """Return the words for events in order of time (``t`` counted from the file's base)."""
        if not len(t):
            return np.empty(0, self.word)
        begins = np.ones(len(t), np.bool_)
        same = (t[1:] == t[:-1]) & (y[1:] == y[:-1]) & (p[1:] == p[:-1])
        begins[1:] = ~(same & (x[1:] > x[:-1]) & (x[1:] >> 5 == x[:-1] >> 5))
        first = np.flatnonzero(begins)
        masks = np.bitwise_or.reduceat(np.uint64(1) << (x & 31).astype(np.uint64), first)
        address = (x[first].astype(np.int64) & ~31) << 11 | y[first]
        heads = p[first].astype(np.int64) << 28 | (t[first] & 0x3F) << 22 | address
        return self._with_times(t[first], heads.astype(np.uint64) << np.uint64(32) | masks)


class Evt3Encoder:
    """Turns packets into EVT3 words; vectors are used where they take fewer words.

    Time words are written for every 4,096 us, also in silence, as a camera does (and repeated where
    events follow): a reader can tell silence from loss, and wraps are never ambiguous. Vectors are
    complete 12 + 12 + 8 triples.
    """

    name, form, word = "evt3", EVT3, np.dtype(np.uint16)

    def __init__(self) -> None:
        self._state = np.full(5, NONE, np.int64)

    def encode(self, t: Times, x: Pixels, y: Pixels, p: Signs) -> NDArray[Any]:
        """Return the words for events in order of time (``t`` counted from the file's base)."""
        if not len(t):
            return np.empty(0, self.word)
        words = self._room(int(t[0]), int(t[-1]), EVT3_WORDS * len(t))
        return words[: encode_evt3_kernel(t, x, y, p, words, self._state)]

    def trigger(self, t_us: int, channel: int, rising: bool) -> NDArray[Any]:
        """Return the words for a trigger edge that follows what was encoded before."""
        words = self._room(t_us, t_us, EVT3_WORDS)
        count = time_words_kernel(t_us, words, 0, self._state)
        words[count] = wire.TRIGGER << 12 | channel << 8 | int(rising)
        return words[: count + 1]

    def _room(self, first_us: int, last_us: int, words: int) -> NDArray[Any]:
        known = int(self._state[0])
        first = first_us >> EVT3.low_bits if known == NONE else known
        return np.empty(words + (last_us >> EVT3.low_bits) - first + 1, self.word)


WordEncoder = Evt2Encoder | Evt3Encoder
ENCODERS: dict[str, type[WordEncoder]] = {
    encoder.name: encoder for encoder in (Evt2Encoder, Evt21Encoder, Evt3Encoder)
}


@njit(cache=True, nogil=True)
def encode_evt3_kernel(t: Times, x: Pixels, y: Pixels, p: Signs, out: Pixels, state: Times) -> Any:
    """Write words to ``out``; ``state`` is (high, low, row, next vector base, its polarity)."""
    n, i = 0, 0
    while i < len(t):
        if t[i] != ((state[0] << 12) | state[1]) or state[1] < 0:
            n = time_words_kernel(t[i], out, n, state)
        if y[i] != state[2]:
            state[2] = y[i]
            out[n] = (wire.ADDR_Y << 12) | y[i]
            n += 1
        last, mask = _run_kernel(t, x, y, p, i)
        joined = state[3] == x[i] and state[4] == p[i]
        if last - i > (VECTOR_WORDS if joined else VECTOR_WORDS + 1):
            n = _vector_kernel(x[i], p[i], mask, joined, out, n, state)
            i = last
        else:
            out[n] = (wire.ADDR_X << 12) | (np.int64(p[i]) << 11) | x[i]
            n += 1
            i += 1
    return n


@njit(cache=True, nogil=True)
def time_words_kernel(t: Integer, out: Pixels, n: Integer, state: Times) -> Any:
    """Write the words that lead to a time; return the number of words by then."""
    high = t >> 12
    if high != state[0]:
        first = high if state[0] < 0 else state[0] + 1
        for value in range(first, high + 1):
            out[n] = (wire.TIME_HIGH << 12) | (value & 0xFFF)
            n += 1
        state[0] = high
    elif (t & 0xFFF) >> REPEAT_BITS != state[1] >> REPEAT_BITS:
        out[n] = (wire.TIME_HIGH << 12) | (high & 0xFFF)
        n += 1
    state[1] = t & 0xFFF
    out[n] = (wire.TIME_LOW << 12) | state[1]
    return n + 1


@njit(cache=True, nogil=True)
def _run_kernel(t: Times, x: Pixels, y: Pixels, p: Signs, i: Integer) -> tuple[int, Any]:
    """Return the end and the mask of the events that one vector from event ``i`` can hold."""
    mask, last = 1, i + 1
    while (
        last < len(t)
        and x[last] > x[last - 1]
        and x[last] < x[i] + wire.VECTOR_WIDTH_PX
        and y[last] == y[i]
        and t[last] == t[i]
        and p[last] == p[i]
    ):
        mask |= 1 << (np.int64(x[last]) - np.int64(x[i]))
        last += 1
    return last, mask


@njit(cache=True, nogil=True)
def _vector_kernel(
    x: Integer, p: Any, mask: Integer, joined: Any, out: Pixels, n: Integer, state: Times
) -> Any:
    if not joined:
        out[n] = (wire.BASE_X << 12) | (np.int64(p) << 11) | x
        n += 1
    out[n] = (wire.VECT_12 << 12) | (mask & 0xFFF)
    out[n + 1] = (wire.VECT_12 << 12) | ((mask >> 12) & 0xFFF)
    out[n + 2] = (wire.VECT_8 << 12) | ((mask >> 24) & 0xFF)
    state[3] = np.int64(x) + wire.VECTOR_WIDTH_PX
    state[4] = np.int64(p)
    return n + VECTOR_WORDS
