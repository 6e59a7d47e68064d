"""AEDAT4 files of iniVation's DV: compressed ones are read by the library aedat.

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
from typing import Any

import numpy as np

from spikingtac.errors import FormatError, MissingExtraError
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
PACKET_LIMIT_BYTES = 1 << 26
"""Longest packet that is read; DV writes some 100 kB."""

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

    Uncompressed files are read directly; the library aedat reads compressed ones.

    Raises:
        MissingExtraError: The file is compressed and the library aedat is not installed.
        FormatError: The file cannot be read, or holds no events.
    """

    format = "AEDAT4"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._head = read_head(path)
        if self._head.compression:
            _decoder(path)
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        return self._head.size

    def _columns(self) -> Iterator[Rows]:
        packets = self._library_packets() if self._head.compression else self._packets()
        for events in packets:
            x, y = events["x"].astype(np.int64), events["y"].astype(np.int64)
            yield x, y, events["on"], events["t"].astype(np.int64)

    def _packets(self) -> Iterator[np.ndarray[Any, np.dtype[Any]]]:
        total = max(self.path.stat().st_size, 1)
        end = self._head.table_position if self._head.table_position > 0 else total
        with self.path.open("rb") as file:
            file.seek(self._head.length)
            while file.tell() < end:
                head = file.read(PACKET_HEAD.size)
                stream, length = PACKET_HEAD.unpack(head.ljust(PACKET_HEAD.size, b"\0"))
                data = file.read(min(length, PACKET_LIMIT_BYTES))
                self.progress = file.tell() / total
                self.losses.add("truncated", int(len(data) < length))
                if stream == self._head.stream:
                    events = _events_of(data)
                    if events is None:
                        self.losses.add("bad_record")
                    else:
                        yield events

    def _library_packets(self) -> Iterator[np.ndarray[Any, np.dtype[Any]]]:
        decoder = iter(_decoder(self.path))
        while True:
            try:
                packet = next(decoder, None)
            except BaseException as error:
                # The library's panics derive from BaseException alone; name them by their class.
                if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
                    raise
                self.losses.add("truncated", int(not self._ends_whole()))
                return
            if packet is None:
                return
            if packet["stream_id"] == self._head.stream and "events" in packet:
                yield packet["events"]

    def _ends_whole(self) -> bool:
        """Whether the packets' lengths add up to the file's."""
        total = self.path.stat().st_size
        with self.path.open("rb") as file:
            at = self._head.length
            while 0 <= at < total:
                file.seek(at)
                head = file.read(PACKET_HEAD.size)
                if len(head) < PACKET_HEAD.size:
                    return False
                at += PACKET_HEAD.size + max(PACKET_HEAD.unpack(head)[1], 0)
        return at == total


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
    for node in ElementTree.fromstring(info).iter("node"):
        kinds = [attr.text for attr in node.findall("attr") if attr.get("key") == "typeIdentifier"]
        if kinds == ["EVTS"]:
            sizes = {attr.get("key"): attr.text for attr in node.iter("attr")}
            width, height = int(sizes.get("sizeX") or 0), int(sizes.get("sizeY") or 0)
            if not (0 < width <= 1 << 15 and 0 < height <= 1 << 15):
                raise ValueError(f"a sensor of {width}x{height} px")
            return int(node.get("name") or 0), (width, height)
    raise ValueError("it holds no stream of events")


def _events_of(data: bytes) -> np.ndarray[Any, np.dtype[Any]] | None:
    """Return the whole events of a size-prefixed EventPacket, or None where it is damaged."""
    try:
        start, count = _Table(data[4:]).vector(0)
        present = (len(data) - 4 - start) // EVENT.itemsize
        return np.frombuffer(data, EVENT, max(min(count, present), 0), start + 4)
    except (struct.error, ValueError):
        return None


def _decoder(path: Path) -> Any:
    try:
        from aedat import Decoder  # type: ignore[import-untyped]
    except ImportError as error:
        raise MissingExtraError(
            "compressed AEDAT4 files need: pip install 'spikingtac[formats]'"
        ) from error
    try:
        return Decoder(str(path))
    except Exception as error:  # the library raises bare exceptions of several kinds
        raise FormatError(f"{str(path)!r} is no readable AEDAT4 file: {error}") from error
