"""EVT words as cameras send them: which encoding and size, and their decoding."""

from typing import Any

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac.events.camera import Address
from spikingtac.events.evt.raw import RawHeader
from spikingtac.events.evt.wire import (
    BYTE_ORDERS,
    ENCODINGS,
    FOREIGN_SHARE,
    NAMES,
    SOUND_SHARE,
    TIME_HIGH,
    Words,
    best_candidate,
    implausible_share,
)
from spikingtac.events.evt.words import Rows, WordStream
from spikingtac.events.formats.codec import Triggers
from spikingtac.types import LossCounters

# Width and height of the sensor that is assumed unless an address names another, px.
GENX320_SIZE = (320, 320)

# Options of addresses whose words come without a header.
WORD_OPTIONS = ("encoding", "size", "order")

NOISE_BYTES = 1 << 14  # Noise in which everything is to be mended, for a warm-up, bytes.

# Steps of the upper time, 0.13 s, by which a piece may be late; beyond, the sensor began anew.
LATEST_STEPS = {"evt2": 2_000, "evt21": 2_000, "evt3": 30}


def header_of(address: Address, encoding: str = "evt2") -> RawHeader:
    """Return what the options of an address say of words that come without a header.

    Args:
        address: With options ``encoding``, ``size`` (320x320 unless given) and, for EVT2.1,
            ``order`` (little unless given).
        encoding: That of an address which names none.

    Raises:
        ConfigError: An option is not valid.
    """
    encoding = address.text("encoding", encoding, ENCODINGS)
    order = address.text("order", "little", BYTE_ORDERS)
    if "order" in address.options and encoding != "evt21":
        raise ConfigError(f"{str(address)!r}: order is of EVT2.1 words; leave it out")
    return RawHeader(encoding=encoding, size=address.size("size") or GENX320_SIZE, byte_order=order)


class CameraWords:
    """A decoder for the words of a camera.

    Args:
        header: What is known of them; encoding and size at least.
        losses: Counters to fill.
        triggers: Where trigger edges are appended.

    Attributes:
        encoding: ``evt2``, ``evt21`` or ``evt3``.
        size: ``(width, height)``, px.
        form: The encoding, with the byte order of EVT2.1.
        word_bytes: Bytes of a word.
    """

    def __init__(self, header: RawHeader, losses: LossCounters, triggers: Triggers) -> None:
        assert header.encoding is not None
        assert header.size is not None
        self.encoding, self.size = header.encoding, header.size
        self._order = header.byte_order or "little"
        self.form = self.encoding + (f"/{self._order}" if self.encoding == "evt21" else "")
        clock = header.time_base_us, header.continuous
        self._stream = WordStream(self.form, self.size, losses, triggers, *clock)
        self._losses = losses
        self._reached: int | None = None
        self.word_bytes = self._stream.word.itemsize
        warm_up(self.form, self.size)

    def feed(self, data: bytes | memoryview, final: bool = False) -> Rows:
        """Return the columns of the events in the next bytes; they are overwritten by the next."""
        return self._stream.feed(data, final)

    def heads(self, data: bytes | bytearray) -> Words:
        """Return the part of each of some whole words that holds its type."""
        return self._stream.heads(np.frombuffer(data, self._stream.word))

    def fits(self, data: bytes) -> bool:
        """Return whether bytes look like whole words of this encoding, with a time among them."""
        return implausible_share(data, self.form, self.size) <= FOREIGN_SHARE

    def fitting(self, data: bytes) -> str | None:
        """Return the options of an address that bytes fit clearly, or None."""
        name, share = best_candidate(data, self.size)
        encoding, _, order = name.partition("/")
        if share > SOUND_SHARE or name == self.form:
            return None
        return f"encoding={encoding}" + (f"&order={order}" if order else "")

    def in_order(self, pieces: list[bytes]) -> list[bytes]:
        """Return pieces that are at hand together by their time; count those that came late.

        A piece that is older than what was fed before stays late: its events are kept, at the time
        that was reached by then.

        Args:
            pieces: Whole words each, as they came.
        """
        late, steps, step = 0, [], 0
        half = 1 << (self._stream.form.high_bits - 1)  # of the counter, which wraps
        for piece in pieces:
            time = self._first_time(piece)
            if time is not None:
                self._reached = time if self._reached is None else self._reached
                step = (time - self._reached + half) % (2 * half) - half
                if step < -LATEST_STEPS[self.encoding]:
                    self._reached, step = time, 0
                late += step < max(steps, default=0)
            steps.append(step)  # a piece without a time word follows the one before it
        self._losses.add("reordered", late)
        if self._reached is not None:
            self._reached += max(0, *steps) if steps else 0
        if not late:
            return pieces
        return [pieces[place] for place in np.argsort(steps, kind="stable")]

    def _first_time(self, piece: bytes) -> int | None:
        heads, bits = self.heads(piece), self._stream.form.high_bits
        times = heads[heads >> bits == TIME_HIGH]
        return int(times[0]) & ((1 << bits) - 1) if len(times) else None

    def describe(self) -> dict[str, Any]:
        """Return the encoding for a manifest."""
        named: dict[str, Any] = {"encoding": NAMES[self.encoding]}
        return named | ({"byte_order": self._order} if self.encoding == "evt21" else {})


def warm_up(form: str, size: tuple[int, int]) -> None:
    """Compile, or load, what decodes and what mends, before words wait for it.

    Args:
        form: ``evt2``, ``evt21`` or ``evt3``, perhaps with a byte order of EVT2.1: ``evt21/big``.
        size: ``(width, height)``, px.
    """
    stream = WordStream(form, size, LossCounters(), Triggers())
    stream.feed(np.random.default_rng(0).bytes(NOISE_BYTES), final=True)
