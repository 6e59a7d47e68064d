"""AEDAT4 files of iniVation's DV, packet by packet: a damaged one costs only itself.

Source: iniVation, "AEDAT 4.0" file format (public documentation): a line of text, an IOHeader and
packets, each a size-prefixed FlatBuffer. The few bytes of FlatBuffers that are needed are laid out
here by hand.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from spikingtac.errors import FormatError
from spikingtac.events.formats.checks.decompress import decompressed
from spikingtac.events.formats.checks.limits import refuse_piece
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows

SIGNATURE = b"#!AER-DAT4.0\r\n"
EVENT = np.dtype(
    {
        "names": ["t", "x", "y", "on"],
        "formats": ["<i8", "<i2", "<i2", "?"],
        "offsets": [0, 8, 10, 12],
        "itemsize": 16,
    }
)
PACKET_HEAD = struct.Struct("<iI")
COMPRESSIONS = {0: "none", 1: "lz4", 2: "lz4", 3: "zstd", 4: "zstd"}
"""What the head's number stands for."""

STREAM_LIMIT = 1 << 10
"""Numbers of streams that are believed."""

SEARCH_BYTES = 1 << 20
_MARKS = {"lz4": (b"\x04\x22\x4d\x18", 8), "zstd": (b"\x28\xb5\x2f\xfd", 8)}
"""How a packet's bytes begin, and how far behind its head; uncompressed ones name their type."""

HEAD_LIMIT_BYTES = 1 << 24
"""Longest head that is believed."""


@dataclass(frozen=True, kw_only=True)
class Aedat4Head:
    """What the head of a file names.

    Attributes:
        stream: Number of the first event stream.
        size: ``(width, height)``, px.
        compression: 0 none, 1 and 2 LZ4, 3 and 4 Zstandard.
        table_position: Where the index at the end begins, or -1.
        length: Bytes before the first packet.
    """

    stream: int
    size: tuple[int, int]
    compression: int
    table_position: int
    length: int


class Aedat4Source(FileSource):
    """Events of the first event stream of an AEDAT4 file.

    Raises:
        MissingExtraError: The file is compressed and the library for it is not installed.
        FormatError: The file cannot be read, holds no events, or a packet is beyond the limit.
    """

    format = "AEDAT4"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._head = read_head(path)
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        return self._head.size

    def _columns(self) -> Iterator[Rows]:
        total = max(self.path.stat().st_size, 1)
        end = self._head.table_position if self._head.table_position > 0 else total
        with self.path.open("rb") as file:
            place = self._head.length
            while place < min(end, total):
                head = _packet_at(file, place, total)
                if head is None:
                    found = _next_packet(file, place + 1, total, self._head)
                    self.losses.add("truncated" if found is None else "bad_record")
                    if found is not None:
                        place = found
                        continue
                stream, length = head or (self._head.stream, total - place - PACKET_HEAD.size)
                place += PACKET_HEAD.size + length
                self.progress = place / total
                if stream == self._head.stream and length > 0:
                    file.seek(place - length)
                    yield from self._events(file, length, cut=head is None)

    def _events(self, file: BinaryIO, length: int, cut: bool) -> Iterator[Rows]:
        """Yield the events of the packet whose bytes come next; damage is counted."""
        where = f"{str(self.path)!r}: a packet"
        refuse_piece(where, length)
        kind = COMPRESSIONS.get(self._head.compression, "unknown")
        try:
            events, whole = _events_of(decompressed(file.read(length), kind, where))
        except (struct.error, ValueError):
            self.losses.add("bad_record", int(not cut))
            return
        self.losses.add("bad_record", int(not (whole or cut)))
        x, y = events["x"].astype(np.int64), events["y"].astype(np.int64)
        yield x, y, events["on"], events["t"].astype(np.int64)


def _packet_at(file: BinaryIO, place: int, total: int) -> tuple[int, int] | None:
    """Return stream and length of the packet at a place, or None where there is none."""
    file.seek(place)
    head = file.read(PACKET_HEAD.size)
    if len(head) < PACKET_HEAD.size:
        return None
    stream, length = PACKET_HEAD.unpack(head)
    fits = 0 <= stream < STREAM_LIMIT and length <= total - place - PACKET_HEAD.size
    return (stream, length) if fits else None


def _next_packet(file: BinaryIO, place: int, total: int, head: Aedat4Head) -> int | None:
    """Return where the next packet of events begins, or None where the rest holds none."""
    mark, before = _MARKS.get(COMPRESSIONS.get(head.compression, ""), (b"EVTS", 16))
    while place < total:
        file.seek(place)
        data = file.read(SEARCH_BYTES + before + len(mark))
        at = data.find(mark, before)
        while 0 <= at < SEARCH_BYTES + before:
            packet = _packet_at(file, place + at - before, total)
            if packet is not None and packet[0] == head.stream and packet[1] > 0:
                return place + at - before
            at = data.find(mark, at + 1)
        place += SEARCH_BYTES
    return None


def read_head(path: Path) -> Aedat4Head:
    """Read the head of an AEDAT4 file.

    Raises:
        FormatError: The head is damaged, or names no stream of events.
    """
    try:
        with path.open("rb") as file:
            if file.read(len(SIGNATURE)) != SIGNATURE:
                raise ValueError("the first line is not that of AEDAT 4.0")
            (length,) = struct.unpack("<I", file.read(4))
            if length > HEAD_LIMIT_BYTES:
                raise ValueError(f"a head of {length} bytes")
            data = file.read(length)
        table = _Table(data)
        info = table.text(2)
        stream, size = _event_stream(info)
        return Aedat4Head(
            stream=stream,
            size=size,
            compression=table.number(0, "<i", 0),
            table_position=table.number(1, "<q", -1),
            length=len(SIGNATURE) + 4 + length,
        )
    except (ValueError, struct.error, ElementTree.ParseError, RecursionError) as error:
        raise FormatError(f"{str(path)!r} is no readable AEDAT4 file: {error}") from error


class _Table:
    """The root table of a FlatBuffer, every offset checked by :mod:`struct`."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        (self._at,) = struct.unpack_from("<I", data, 0)
        self._vtable = self._at - struct.unpack_from("<i", data, self._at)[0]
        if self._vtable < 0:
            raise ValueError("an offset leads out of the buffer")
        (self._length,) = struct.unpack_from("<H", data, self._vtable)

    def place(self, field: int) -> int | None:
        """Return where a field lies, or None where it is left out."""
        entry = 4 + 2 * field
        if entry + 2 > self._length:
            return None
        (offset,) = struct.unpack_from("<H", self._data, self._vtable + entry)
        return self._at + offset if offset else None

    def number(self, field: int, kind: str, default: int) -> int:
        """Return a number of a :mod:`struct` type."""
        place = self.place(field)
        return default if place is None else struct.unpack_from(kind, self._data, place)[0]

    def vector(self, field: int) -> tuple[int, int]:
        """Return where a vector's first element lies, and its length."""
        place = self.place(field)
        if place is None:
            return 0, 0
        start = place + struct.unpack_from("<I", self._data, place)[0]
        return start + 4, struct.unpack_from("<I", self._data, start)[0]

    def text(self, field: int) -> str:
        """Return a string."""
        start, length = self.vector(field)
        return self._data[start : start + length].decode("utf-8")


def _event_stream(info: str) -> tuple[int, tuple[int, int]]:
    """Return number and size of the first event stream that the XML names."""
    if "<!" in info:
        raise ValueError("its XML declares entities, which no recorder does")
    for node in ElementTree.fromstring(info).iter("node"):
        kinds = [attr.text for attr in node.findall("attr") if attr.get("key") == "typeIdentifier"]
        if kinds == ["EVTS"]:
            sizes = {attr.get("key"): attr.text for attr in node.iter("attr")}
            width, height = int(sizes.get("sizeX") or 0), int(sizes.get("sizeY") or 0)
            if not (0 < width <= 1 << 15 and 0 < height <= 1 << 15):
                raise ValueError(f"a sensor of {width}x{height} px")
            return int(node.get("name") or 0), (width, height)
    raise ValueError("it holds no stream of events")


def _events_of(data: bytes) -> tuple[np.ndarray[Any, np.dtype[Any]], bool]:
    """Return the events of a size-prefixed EventPacket, and whether they are as many as it says.

    Raises:
        ValueError: The packet is damaged; :class:`struct.error` where an offset leads out of it.
    """
    start, count = _Table(data[4:]).vector(0)
    present = max((len(data) - 4 - start) // EVENT.itemsize, 0)
    if not present:
        return np.empty(0, EVENT), not count
    return np.frombuffer(data, EVENT, present, start + 4), count == present
