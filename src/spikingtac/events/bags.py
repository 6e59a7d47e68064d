"""MCAP files and ROS 1 bags, as raw messages of given types.

Sources: MCAP, "Format Specification" (public): records of an opcode (one byte), a length (eight)
and content. ROS wiki, "Bags/Format/2.0" (public): records of a header with named fields and data.
In both, messages lie in chunks, which may be compressed. Both are read record by record: a damaged
chunk is left out, and what follows it is read.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from spikingtac.events.formats.file_source import Read, place_after_damage, reader_of
from spikingtac.events.formats.limits import (
    DamagedPieceError,
    decompressed,
    refuse_piece,
)

Count = Callable[[str], None]  # Counts one more of a kind of damage.


class RawMessage(NamedTuple):
    """A message as it was stored; ``cdr`` for ROS 2, else the ROS 1 serialisation."""

    topic: str
    data: bytes
    cdr: bool
    kind: str


class _Record(NamedTuple):
    """A record: its kind, named fields, and where its content begins and ends."""

    kind: int
    fields: dict[bytes, bytes]
    start: int
    end: int


class Bag:
    """A file of records, some of which are chunks of others.

    Attributes:
        MAGIC: How the file begins.
        MARK: What a record may begin with, where reading goes on after damage.
        CHUNK: Kind of the records that hold others.
        READ: Kinds that are read.
        LAST: Kinds after which nothing follows that is read.
    """

    MAGIC: ClassVar[bytes]
    MARK: ClassVar[re.Pattern[bytes]]
    CHUNK: ClassVar[int]
    READ: ClassVar[tuple[int, ...]]
    LAST: ClassVar[tuple[int, ...]] = ()

    def __init__(self, path: Path, types: tuple[str, ...], count: Count) -> None:
        self._path, self._types, self._count = path, types, count
        self._where = f"{str(path)!r}: a record"

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages; damage is counted."""
        end = self._path.stat().st_size
        with self._path.open("rb") as file:
            read, place = reader_of(file), len(self.MAGIC)
            while place < end:
                record = self._record(read, place, end)
                if record is None:
                    proven = partial(self._proven, read, end)
                    found = place_after_damage(read, place + 1, end, self.MARK, proven)
                    self._count("truncated" if found is None else "bad_record")
                    if found is None:
                        return
                    place = found
                    continue
                if record.kind in self.LAST:
                    return
                place = record.end
                if record.kind in self.READ:
                    refuse_piece(self._where, record.end - record.start)
                    yield from self._taken(record, read)
        if self.LAST:
            self._count("truncated")

    def _record(self, read: Read, place: int, end: int) -> _Record | None:
        """Return the record that begins at a place, or None where there is none."""
        raise NotImplementedError

    def _proven(self, read: Read, end: int, place: int) -> int | None:
        """Return where the record begins that a mark belongs to, or None."""
        raise NotImplementedError

    def _content(self, record: _Record, content: bytes) -> Iterator[RawMessage]:
        """Yield the message in a record, or keep what it says of others."""
        raise NotImplementedError

    def _unpacked(self, record: _Record, content: bytes) -> bytes:
        """Return the records in a chunk."""
        raise NotImplementedError

    def _taken(self, record: _Record, read: Read) -> Iterator[RawMessage]:
        content = read(record.start, record.end - record.start)
        try:
            if record.kind != self.CHUNK:
                yield from self._content(record, content)
                return
            records, place = self._unpacked(record, content), 0
            inside = reader_of(io.BytesIO(records))
            while place < len(records):
                inner = self._record(inside, place, len(records))
                if inner is None or inner.kind == self.CHUNK:
                    raise DamagedPieceError("a record leads out of its chunk")
                place = inner.end
                yield from self._taken(inner, inside)
        except (struct.error, DamagedPieceError, KeyError):
            self._count("bad_record")


class Mcap(Bag):
    """An MCAP file."""

    MAGIC = b"\x89MCAP0\r\n"
    MARK = re.compile(rb"(?=[\x01-\x0f].{5}\x00{3})", re.DOTALL)  # shorter than 2^40 bytes
    SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x03, 0x04, 0x05, 0x06
    READ = (SCHEMA, CHANNEL, MESSAGE, CHUNK)
    LAST = (0x0F, 0x02)  # the end of the data, and the footer
    HEAD, MESSAGE_HEAD, CHUNK_HEAD = map(struct.Struct, ("<BQ", "<HIQQ", "<QQQI"))
    PROOF_RECORDS = 2  # Records in a row that have to make sense after damage.

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, int, str]] = {}  # topic, schema, encoding

    def _record(self, read: Read, place: int, end: int) -> _Record | None:
        head = read(place, self.HEAD.size)
        if len(head) < self.HEAD.size:
            return None
        kind, length = self.HEAD.unpack(head)
        start = place + self.HEAD.size
        sound = 0 < kind < 16 and length <= end - start
        return _Record(kind, {}, start, start + length) if sound else None

    def _proven(self, read: Read, end: int, place: int) -> int | None:
        at = place
        for _ in range(self.PROOF_RECORDS):
            record = self._record(read, at, end)
            if record is None or record.start == record.end:
                return None
            if record.kind == self.LAST[0]:
                return place
            at = record.end
        return place

    def _content(self, record: _Record, content: bytes) -> Iterator[RawMessage]:
        if record.kind == self.SCHEMA:
            self._schemas[struct.unpack_from("<H", content)[0]] = _text(content, 2)[0]
        elif record.kind == self.CHANNEL:
            number, schema = struct.unpack_from("<HH", content)
            topic, place = _text(content, 4)
            self._channels[number] = (topic, schema, _text(content, place)[0])
        else:
            number = self.MESSAGE_HEAD.unpack_from(content)[0]
            topic, schema, encoding = self._channels.get(number, ("", -1, ""))
            kind = self._schemas.get(schema, "")
            if kind in self._types:
                yield RawMessage(topic, content[self.MESSAGE_HEAD.size :], encoding != "ros1", kind)

    def _unpacked(self, record: _Record, content: bytes) -> bytes:
        _, _, size, checksum = self.CHUNK_HEAD.unpack_from(content)
        kind, place = _text(content, self.CHUNK_HEAD.size)
        (length,) = struct.unpack_from("<Q", content, place)
        stored = content[place + 8 : place + 8 + length]
        if len(stored) < length:
            raise DamagedPieceError("the chunk ends early")
        records = decompressed(stored, kind, self._where)
        if len(records) != size or (checksum and zlib.crc32(records) != checksum):
            raise DamagedPieceError("the checksum does not fit")
        return records


def _text(content: bytes, place: int) -> tuple[str, int]:
    """Return a string and where it ends."""
    (length,) = struct.unpack_from("<I", content, place)
    text = content[place + 4 : place + 4 + length]
    if len(text) < length:
        raise DamagedPieceError("a text ends early")
    return text.decode("utf-8", "replace"), place + 4 + length


class Ros1(Bag):
    """A ROS 1 bag."""

    MAGIC = b"#ROSBAG V2.0\n"
    MARK = re.compile(rb"\x04\x00\x00\x00op=\x05", re.DOTALL)  # the field that names a chunk
    MESSAGE, CHUNK, CONNECTION = 0x02, 0x05, 0x07
    READ = (MESSAGE, CHUNK, CONNECTION)
    LENGTH = struct.Struct("<I")
    HEADER_LIMIT_BYTES = 1 << 20  # Longest header that is believed; it holds a topic's name.
    SEARCH_BACK_BYTES = 256  # How far before its field ``op`` a chunk's header is looked for.

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._connections: dict[bytes, tuple[str, str]] = {}  # topic, type

    def _record(self, read: Read, place: int, end: int) -> _Record | None:
        try:
            (length,) = self.LENGTH.unpack(read(place, 4))
            if not 0 < length <= min(self.HEADER_LIMIT_BYTES, end - place - 8):
                return None
            fields = _fields(read(place + 4, length))
            start = place + length + 8
            (data_length,) = self.LENGTH.unpack(read(start - 4, 4))
            record = _Record(fields[b"op"][0], fields, start, start + data_length)
        except (struct.error, DamagedPieceError, KeyError, IndexError):
            return None
        return record if record.end <= end else None

    def _proven(self, read: Read, end: int, place: int) -> int | None:
        for begin in range(place - 4, max(place - self.SEARCH_BACK_BYTES, 0) - 1, -1):
            record = self._record(read, begin, end)
            if record is not None and record.kind == self.CHUNK:
                return begin
        return None

    def _content(self, record: _Record, content: bytes) -> Iterator[RawMessage]:
        connection = record.fields[b"conn"]
        if record.kind == self.CONNECTION:
            texts = record.fields.get(b"topic", b""), _fields(content)[b"type"]
            topic, kind = (text.decode("utf-8", "replace") for text in texts)
            self._connections[connection] = topic, kind
            return
        topic, kind = self._connections.get(connection, ("", ""))
        if record.kind == self.MESSAGE and kind in self._types:
            yield RawMessage(topic, content, cdr=False, kind=kind)

    def _unpacked(self, record: _Record, content: bytes) -> bytes:
        kind = record.fields.get(b"compression", b"").decode("latin-1")
        records = decompressed(content, kind, self._where)
        if len(records) != self.LENGTH.unpack(record.fields[b"size"])[0]:
            raise DamagedPieceError("the chunk holds another number of bytes than it says")
        return records


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a header of ROS 1.

    Raises:
        DamagedPieceError: It does not end where its last field ends, or a field has no name.
    """
    found, place = {}, 0
    while place < len(header):
        (length,) = struct.unpack_from("<I", header, place)
        field = header[place + 4 : place + 4 + length]
        name, equals, value = field.partition(b"=")
        if len(field) < length or not (name and equals):
            raise DamagedPieceError("a field ends early, or has no name")
        found[name] = value
        place += 4 + length
    return found
