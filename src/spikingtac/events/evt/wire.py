"""The words of the RAW formats as NumPy sees them: what tells formats apart and mends damage.

Sources: Prophesee, "EVT 2.0 Format", "EVT 2.1 Format", "EVT 3.0 Format" (public documentation).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Words = NDArray[Any]
Flags = NDArray[np.bool_]

TIME_HIGH = 0x8  # Type of the words that hold the upper time, in every format.

EVENT_OFF, EVENT_ON, TRIGGER = 0x0, 0x1, 0xA

# Pixels that one word of EVT2.1 covers, or a base of EVT3 and its 12 + 12 + 8 vectors.
VECTOR_WIDTH_PX = 32

ADDR_Y, ADDR_X, BASE_X, VECT_12, VECT_8 = 0x0, 0x2, 0x3, 0x4, 0x5
TIME_LOW = 0x6  # These are types of EVT3.

# First of the types for vendors' extensions, which begin with those of an IMU.
VENDOR, CONTINUED_4 = 0xD, 0x7


class WordFormat(NamedTuple):
    """How a format divides the time, and which of its steps are odd.

    Attributes:
        low_bits: Bits of the lower time.
        high_bits: Bits of the upper time, and below the type in a word (an upper half of EVT2.1).
        padding: Word that completes a buffer.
        known_types: Types that the format defines, as a bit set.
        channels: Mask of a trigger's channel.
        far_steps: Distance of an upper time from the chunk's that is odd.
        fall_steps: Fall of the lower time between two words that is odd.
        leap_steps: Step of the upper time that is implausible within a sample.
    """

    low_bits: int
    high_bits: int
    padding: int
    known_types: int
    channels: int
    far_steps: int
    fall_steps: int
    leap_steps: int


# Of EVT2 and EVT2.1: a minute is far, a second is a leap. Of EVT3: four seconds are far, one is a
# leap.
EVT2 = WordFormat(6, 28, 0x99999999, 0b1110_0101_0000_0011, 0x1F, 60_000_000 >> 6, 8, 1 << 14)
EVT3 = WordFormat(12, 12, 0x9999, 0b1100_0101_1111_1101, 0xF, 4_000_000 >> 12, 64, 1 << 8)

ENCODINGS = ("evt2", "evt21", "evt3")
NAMES = {"evt2": "EVT2", "evt21": "EVT2.1", "evt3": "EVT3"}
BYTE_ORDERS = ("little", "legacy", "big")  # Of EVT2.1 words; the first one is the usual one.

# Type of a word, and the most events that it can stand for.
WORDS = {"evt2": ("u4", 1), "evt21": ("u8", VECTOR_WIDTH_PX), "evt3": ("u2", 12)}

# Encodings, with the byte order of EVT2.1: what a stream of words may be.
CANDIDATES = ("evt3", "evt2", *(f"evt21/{order}" for order in BYTE_ORDERS))
FOREIGN_SHARE = 0.15  # Share of implausible words from which on a claimed format is doubted.
# Share of implausible words up to which a format is believed that nothing names: of recordings it
# is 0.000, of arrays, pickles and programs 0.1 to 1.
SOUND_SHARE = 0.02
WIDEST_PX = 1 << 11  # Columns and rows that an address names.
LARGEST_PX = (1280, 720)  # The largest event sensor on the market, where no size is told.


class WordView(NamedTuple):
    """What each of some words says.

    Attributes:
        unknown: Its type is not defined.
        outside: It names a place beyond the sensor, or no pixel at all.
        rare: It is a trigger or a vendor's extension.
        is_high: It holds the upper time.
        is_low: It holds the lower time.
        time: That time.
    """

    unknown: Flags
    outside: Flags
    rare: Flags
    is_high: Flags
    is_low: Flags
    time: NDArray[np.int64]


class Wire:
    """How the words of an encoding lie in bytes.

    Args:
        name: One of :data:`CANDIDATES`; ``evt21`` alone is in the usual byte order.

    Attributes:
        form: How the format divides the time.
        word: Type of a word on the wire.
        events_per_word: Most events that a word can stand for.
        upper: Which half of an EVT2.1 word is the upper one.
    """

    def __init__(self, name: str) -> None:
        self.encoding, _, order = name.partition("/")
        self.form = EVT3 if self.encoding == "evt3" else EVT2
        mark = ">" if order == "big" else "<"
        kind, self.events_per_word = WORDS[self.encoding]
        self.word = np.dtype(mark + kind)
        self._half, self.upper = np.dtype(f"{mark}u4"), int(order in ("", "little"))

    def halves(self, words: Words) -> Words:
        """Return ``(n, 2)`` halves of EVT2.1 words, as they follow each other in the bytes."""
        return words.view(self._half).reshape(-1, 2)

    def heads(self, words: Words) -> Words:
        """Return the part of each word that holds its type."""
        return self.halves(words)[:, self.upper] if self.encoding == "evt21" else words

    def view(self, words: Words, size: tuple[int, int]) -> WordView:
        """Return what each word says, on a sensor of a size, px."""
        form, heads = self.form, self.heads(words)
        kind, row = heads >> form.high_bits, heads & 0x7FF
        is_high = kind == TIME_HIGH
        if self.encoding == "evt3":
            is_low, low = kind == TIME_LOW, heads & 0xFFF
            column = (kind == ADDR_X) | (kind == BASE_X)
            outside = ((kind == ADDR_Y) & (row >= size[1])) | (column & (row >= size[0]))
        else:
            is_low, low = kind <= EVENT_ON, (heads >> 22) & 0x3F
            column = (heads >> 11) & 0x7FF
            outside = (column >= size[0]) | (row >= size[1])
            if self.encoding == "evt21":
                masks = self.halves(words)[:, 1 - self.upper]
                outside |= (masks == 0) | (column % VECTOR_WIDTH_PX != 0)
            outside &= is_low
        undefined = (form.known_types >> kind.astype(np.int64)) & 1 == 0
        return WordView(
            unknown=undefined & (heads != form.padding),
            outside=outside,
            rare=(kind == TRIGGER) | (kind == CONTINUED_4) | (kind >= VENDOR),
            is_high=is_high,
            is_low=is_low,
            time=np.where(is_high, heads & ((1 << form.high_bits) - 1), low).astype(np.int64),
        )


def implausible_share(data: bytes, candidate: str, size: tuple[int, int] | None) -> float:
    """Return the share of words that make no sense; 1 where none holds the upper time."""
    wire = Wire(candidate)
    words = np.frombuffer(data, wire.word, len(data) // wire.word.itemsize)
    view = wire.view(words, size or LARGEST_PX)
    if not view.is_high.any():
        return 1.0
    clock = np.flatnonzero(view.is_low | view.is_high)
    low, time = view.is_low[clock], view.time[clock]
    falls = low[1:] & low[:-1] & (np.diff(time) < -wire.form.fall_steps)
    leaps = np.diff(time[~low]) % (1 << wire.form.high_bits) > wire.form.leap_steps
    row = wire.heads(words) >> wire.form.high_bits == ADDR_Y
    idle = row[1:] & row[:-1] & (candidate == "evt3")  # no row follows another; zeros in arrays do
    odd = falls, leaps, idle, view.unknown | view.outside
    return sum(map(np.count_nonzero, odd)) / len(words)


def best_candidate(
    data: bytes, size: tuple[int, int] | None, candidates: tuple[str, ...] = CANDIDATES
) -> tuple[str, float]:
    """Return the candidate with the least implausible share, and that share."""
    shares = {name: implausible_share(data, name, size) for name in candidates}
    name = min(shares, key=lambda key: shares[key])
    return name, shares[name]


def time_words(view: WordView) -> tuple[NDArray[np.int64], NDArray[np.int64], Flags]:
    """Return the words of upper time: the index of each among the words, and what it says.

    The third array tells whether the lower time fell from before it to after it: a step is due.
    """
    clock = np.flatnonzero(view.is_low | view.is_high)
    high, low = view.is_high[clock], np.where(view.is_low[clock], view.time[clock], 0)
    # The lower time before each: that of the latest word which holds one.
    latest = np.maximum.accumulate(np.where(high, -1, np.arange(len(clock))))
    before = np.where(latest >= 0, low[latest], 0)
    # An empty list would make floats of it where there is no time word, and compile a kernel anew.
    falls = np.append(~high[1:] & (low[1:] < before[:-1]), np.zeros(min(len(clock), 1), np.bool_))
    position = clock[high]
    return position, view.time[position], falls[high]
