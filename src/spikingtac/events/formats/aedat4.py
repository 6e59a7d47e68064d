"""AEDAT4 files of iniVation's DV, packet by packet: a damaged one costs only itself.

Source: iniVation, "AEDAT 4.0" file format (public documentation): a line of text, an IOHeader and
packets, each a size-prefixed FlatBuffer. The few bytes of FlatBuffers that are needed are laid out
here by hand.
"""

import re
import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from spikingtac.errors import FormatError
from spikingtac.events.formats import pieces
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows, chosen_sensor

SIGNATURE = b"#!AER-DAT4.0\r\n"
EVENT = np.dtype([("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("on", "?")], align=True)
PACKET_HEAD = struct.Struct("<iI")

# What the head's number stands for.
COMPRESSIONS = {0: "none", 1: "lz4", 2: "lz4", 3: "zstd", 4: "zstd"}

STREAM_LIMIT = 1 << 10  # Numbers of streams that are believed.

# Type of a trigger -> channel (0 the external input, 1 the camera's generator) and whether the
# signal rose, which begins a pulse; other types are no edges of a signal.
EDGES = {1: (0, True), 2: (0, False), 3: (0, True), 4: (1, True), 5: (1, False)}

# How a packet's bytes begin, and how far behind its head; uncompressed ones name their type.
_MARKS = {"lz4": (b"\x04\x22\x4d\x18", 8), "zstd": (pieces.ZSTD, 8)}

HEAD_LIMIT_BYTES = 1 << 24  # Longest head that is believed.

Streams = list[tuple[int, tuple[int, int], str]]  # Number, size (px) and name of each.


class Aedat4Source(FileSource):
    """Events of one camera in an AEDAT4 file, and the trigger edges.

    Raises:
        MissingExtraError: The file is compressed and the library for it is not installed.
        FormatError: The file cannot be read, holds no events, or a packet is beyond the limit.
        ConfigError: It holds several cameras, and none was chosen.
    """

    format = "AEDAT4"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        streams, triggers = self._read_head(path)
        cameras = [f"{name}, {size[0]}x{size[1]} px" for _, size, name in streams]
        self._stream, self._named_size, own = streams[chosen_sensor(cameras, options.sensor, path)]
        named = [number for number, name in triggers if name == own]
        self._edges = named or [number for number, _ in triggers]
        mark, self._before_mark = _MARKS.get(self._compression, (b"EVTS", 16))
        self._mark = re.compile(re.escape(mark))
        super().__init__(path, options)

    def _read_head(self, path: Path) -> tuple[Streams, list[tuple[int, str]]]:
        """Return number, size and name of each stream of events, and those of trigger edges."""
        try:
            with path.open("rb") as file:
                if file.read(len(SIGNATURE)) != SIGNATURE:
                    raise ValueError("the first line is not that of AEDAT 4.0")
                (length,) = struct.unpack("<I", file.read(4))
                if length > HEAD_LIMIT_BYTES:
                    raise ValueError(f"a head of {length} bytes")
                table = _Table(file.read(length))
            self._begin = len(SIGNATURE) + 4 + length
            self._compression = COMPRESSIONS.get(table.number(0, "<i", 0), "unknown")
            self._table_position = table.number(1, "<q", -1)  # of the index at the end, or -1
            return _streams_named(table.text(2))
        except (ValueError, struct.error, ElementTree.ParseError, RecursionError) as error:
            raise FormatError(f"{str(path)!r} is no readable AEDAT4 file: {error}") from error

    def _columns(self) -> Iterator[Rows]:
        total = self.path.stat().st_size
        span = self._begin, min(self._table_position, total) if self._table_position > 0 else total
        where = f"{str(self.path)!r}: a packet"
        form = pieces.Form(self._mark, self._packet_at, self._proven)
        with self.path.open("rb") as file:
            read = pieces.reader_of(file)
            for stream, start, stop, _ in pieces.walk(form, read, span, self.losses.add):
                self.progress = stop / total
                cut = stream == pieces.CUT
                start += PACKET_HEAD.size * cut
                if not (cut or stream in (self._stream, *self._edges)) or start >= stop:
                    continue
                pieces.refuse_piece(where, stop - start)
                try:
                    data = pieces.decompressed(read(start, stop - start), self._compression, where)
                    if cut or stream == self._stream:
                        yield self._events(data, cut)
                    else:
                        self._take_triggers(data)
                except (struct.error, ValueError):
                    self.losses.add("bad_record", int(not cut))

    def _packet_at(self, read: pieces.Read, place: int, end: int) -> pieces.Piece | None:
        """Return the packet at a place, or None where there is none."""
        head = read(place, PACKET_HEAD.size)
        if len(head) < PACKET_HEAD.size:
            return None
        stream, length = PACKET_HEAD.unpack(head)
        start = place + PACKET_HEAD.size
        fits = 0 <= stream < STREAM_LIMIT and length <= end - start
        return pieces.Piece(stream, start, start + length) if fits else None

    def _proven(self, read: pieces.Read, place: int, end: int) -> int | None:
        """Return where the packet of events with a mark begins, or None where there is none."""
        begin = max(place - self._before_mark, 0)
        packet = self._packet_at(read, begin, end)
        sound = packet is not None and packet.kind == self._stream and packet.end > packet.start
        return begin if sound else None

    def _events(self, data: bytes, cut: bool) -> Rows:
        """Return the events of a size-prefixed EventPacket; count where they are not as many."""
        start, count = _Table(data[4:]).vector(0)
        present = max((len(data) - 4 - start) // EVENT.itemsize, 0)
        events = np.frombuffer(data, EVENT, present, start + 4) if present else np.empty(0, EVENT)
        self.losses.add("bad_record", int(count != present and not cut))
        return events["x"], events["y"], events["on"], events["t"]

    def _take_triggers(self, data: bytes) -> None:
        """Take the edges of a size-prefixed TriggerPacket."""
        packet = data[4:]
        start, count = _Table(packet).vector(0)
        if count > len(packet) // 4:
            raise ValueError(f"{count} triggers in {len(packet)} bytes")
        for place in range(start, start + 4 * count, 4):
            edge = _Table(packet, place)
            kind = edge.number(1, "<b", 0)
            if kind in EDGES:
                self.triggers.append(edge.number(0, "<q", 0), *EDGES[kind])
                self.losses.add("trigger")


class _Table:
    """A table of a FlatBuffer, the root one unless told; every offset checked by :mod:`struct`."""

    def __init__(self, data: bytes, place: int = 0) -> None:
        self._data = data
        self._at = place + struct.unpack_from("<I", data, place)[0]
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


def _streams_named(info: str) -> tuple[Streams, list[tuple[int, str]]]:
    """Return the streams of events that the XML names, and the numbers of those of triggers."""
    if "<!" in info:
        raise ValueError("its XML declares entities, which no recorder does")
    events, triggers = [], []
    for node in ElementTree.fromstring(info).iter("node"):
        kinds = [attr.text for attr in node.findall("attr") if attr.get("key") == "typeIdentifier"]
        told = {attr.get("key"): attr.text or "" for attr in node.iter("attr")}
        name = told.get("source") or told.get("originalModuleName") or "camera"
        if kinds == ["TRIG"]:
            triggers.append((int(node.get("name") or 0), name))
        if kinds == ["EVTS"]:
            width, height = int(told.get("sizeX") or 0), int(told.get("sizeY") or 0)
            if not (0 < width <= 1 << 15 and 0 < height <= 1 << 15):
                raise ValueError(f"a sensor of {width}x{height} px")
            events.append((int(node.get("name") or 0), (width, height), name))
    if not events:
        raise ValueError("it holds no stream of events")
    return events, triggers
