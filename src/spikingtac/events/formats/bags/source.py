"""ROS bags with ``event_camera_msgs/EventPacket``: ROS 1, ROS 2 sqlite3 and MCAP.

The message is read by its published layout, so bags without type definitions (or with ones in
ros2idl) are read as well. Source: event_camera_msgs, ``msg/EventPacket.msg`` (public).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from spikingtac.errors import FormatError
from spikingtac.events.formats.bags.messages import messages_of
from spikingtac.events.formats.bags.raw_message import RawMessage
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows

MONO_EVENT = np.dtype("<u8")
"""Encoding ``mono``: from the lowest bit, 32 bits of time (ns after the base), 16 x, 15 y, 1 p."""

MESSAGE_TYPES = ("event_camera_msgs/msg/EventPacket", "event_camera_msgs/EventPacket")
ENCODINGS = ("evt3", "evt2", "evt21", "mono")
NS_PER_US = 1_000
PIECE_BYTES = 1 << 18
"""Bytes of a message that are decoded at once: a word may stand for 32 events."""


class _Packet(NamedTuple):
    width: int
    height: int
    sequence: int
    base_ns: int
    encoding: str
    events: bytes


class RosSource(FileSource):
    """Events of a bag; EVT3 words keep their state from message to message.

    Sequence numbers that are left out count as ``gap``; messages that do not parse as
    ``bad_record``, those of other encodings as ``unknown_message``.

    Raises:
        FormatError: The bag holds no event packets, or only encodings that are not read.
        MissingExtraError: The storage needs a library that is not installed.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.format = "ROS bag"
        first = next(self._packets_of(path), None)
        if first is None:
            raise FormatError(
                f"{str(path)!r} holds no readable event_camera_msgs/EventPacket; "
                "record the camera's packet topic, not a rendered image"
            )
        if first.encoding not in ENCODINGS:
            raise FormatError(
                f"{str(path)!r}: events are encoded as {first.encoding!r}, which is not read "
                f"(valid: {', '.join(ENCODINGS)}); set the driver to one of these, or convert "
                "the bag with event_camera_tools"
            )
        self.format = f"ROS bag ({first.encoding})"
        self._first = first
        self.checked = first.encoding != "mono"  # decoders of words check what they decode
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        width, height = self._first.width, self._first.height
        return (width, height) if width > 0 and height > 0 else self._size_from_events()

    def _columns(self) -> Iterator[Rows]:
        reader = _reader(self._first.encoding, self)
        following: int | None = None
        for packet in self._packets_of(self.path):
            if packet.encoding != self._first.encoding:
                self.losses.add("unknown_message")
                continue
            if following is not None and packet.sequence > following:
                self.losses.add("gap", 1)
            following = packet.sequence + 1
            yield from reader(packet)

    def _packets_of(self, path: Path) -> Iterator[_Packet]:
        topic: str | None = None
        for message in messages_of(path, MESSAGE_TYPES, self._count):
            if topic is None:
                topic = message.topic
            if message.topic != topic:
                self._count("unknown_message")
                continue
            try:
                yield _parsed(message)
            except (struct.error, UnicodeDecodeError, IndexError, ValueError):
                self._count("bad_record")

    def _count(self, kind: str) -> None:
        if hasattr(self, "losses"):
            self.losses.add(kind)


class _Cursor:
    """Reads fields of a message one after the other; CDR aligns them, ROS 1 does not."""

    def __init__(self, data: bytes, order: str, origin: int, aligned: bool) -> None:
        self._data, self._order, self._origin, self._aligned = data, order, origin, aligned
        self._at = origin

    def number(self, kind: str) -> int:
        """Read a number of a :mod:`struct` type."""
        length = struct.calcsize(kind)
        if self._aligned:
            self._at += -(self._at - self._origin) % length
        (value,) = struct.unpack_from(self._order + kind, self._data, self._at)
        self._at += length
        return value

    def block(self) -> bytes:
        """Read a length and so many bytes."""
        length = self.number("I")
        block = self._data[self._at : self._at + length]
        if len(block) < length:
            raise ValueError("the message ends early")
        self._at += length
        return block


def _parsed(message: RawMessage) -> _Packet:
    if message.cdr:
        order = "<" if message.data[1] & 1 else ">"
        cursor = _Cursor(message.data, order, 4, aligned=True)
    else:
        cursor = _Cursor(message.data, "<", 0, aligned=False)
        cursor.number("I")  # sequence number of the ROS 1 header
    cursor.number("I")
    cursor.number("I")
    cursor.block()
    height, width = cursor.number("I"), cursor.number("I")
    sequence, base_ns = cursor.number("Q"), cursor.number("Q")
    encoding = cursor.block().rstrip(b"\0").decode("ascii")
    cursor.number("B")  # byte order of the sender; the encodings are little-endian
    return _Packet(width, height, sequence, base_ns, encoding, cursor.block())


class _Reader(Protocol):
    def __call__(self, packet: _Packet) -> Iterator[Rows]:
        """Yield the columns of a packet's events."""
        ...


class _WordReader:
    """Feeds the words of each message to one stateful decoder."""

    def __init__(self, encoding: str, source: RosSource) -> None:
        from spikingtac.events.formats.evt.raw import word_decoder
        from spikingtac.events.formats.evt.words import WordStream

        decoder = word_decoder(encoding, source.size)
        self._stream = WordStream(decoder, source.losses, source.triggers)

    def __call__(self, packet: _Packet) -> Iterator[Rows]:
        """Yield the columns of a packet's events."""
        for first in range(0, max(len(packet.events), 1), PIECE_BYTES):
            last = first + PIECE_BYTES
            yield self._stream.feed(packet.events[first:last], final=last >= len(packet.events))


class _MonoReader:
    """Reads the encoding ``mono``: absolute times, one word an event."""

    def __init__(self) -> None:
        self._start_ns: int | None = None

    def __call__(self, packet: _Packet) -> Iterator[Rows]:
        """Yield the columns of a packet's events, from the first message's base on."""
        if self._start_ns is None:
            self._start_ns = packet.base_ns
        usable = len(packet.events) // MONO_EVENT.itemsize * MONO_EVENT.itemsize
        words = np.frombuffer(packet.events[:usable], MONO_EVENT)
        offset_us, rest_ns = divmod(packet.base_ns - self._start_ns, NS_PER_US)
        t_ns = (words & np.uint64(0xFFFFFFFF)).astype(np.int64)
        x = ((words >> np.uint64(32)) & np.uint64(0xFFFF)).astype(np.int64)
        y = ((words >> np.uint64(48)) & np.uint64(0x7FFF)).astype(np.int64)
        t = (t_ns + rest_ns) // NS_PER_US + offset_us
        yield x, y, (words >> np.uint64(63)).astype(np.bool_), t


def _reader(encoding: str, source: RosSource) -> _Reader:
    return _MonoReader() if encoding == "mono" else _WordReader(encoding, source)
