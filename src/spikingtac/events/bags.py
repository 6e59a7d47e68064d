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
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, NamedTuple

from spikingtac.events.formats.pieces import (
    CUT,
    Count,
    DamagedPieceError,
    Piece,
    Read,
    decompressed,
    pieces,
    reader_of,
    refuse_piece,
)


class RawMessage(NamedTuple):
    """A message as it was stored; ``cdr`` for ROS 2, else the ROS 1 serialisation."""

    topic: str
    data: bytes
    cdr: bool
    kind: str


class _Bag:
    """A file of records, some of which are chunks of others.

    Attributes:
        MAGIC: How the file begins.
        CHUNK: Kind of the records that hold others.
        READ: Kinds that are read.
        LAST: Kinds after which nothing follows that is read.
    """

    MAGIC: ClassVar[bytes]
    CHUNK: ClassVar[int]
    READ: ClassVar[tuple[int, ...]]
    LAST: ClassVar[tuple[int, ...]] = ()
    mark: re.Pattern[bytes]

    def __init__(self, path: Path, types: tuple[str, ...], count: Count) -> None:
        self._path, self._types, self._count = path, types, count
        self._where = f"{str(path)!r}: a record"
        self._types_of: dict[bytes, str] = {}  # Type of each schema or connection.
        self._channels: dict[bytes, tuple[str, bytes, str]] = {}  # Topic, schema and encoding.

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages; damage is counted."""
        span = len(self.MAGIC), self._path.stat().st_size
        with self._path.open("rb") as file:
            read = reader_of(file)
            for record in pieces(self, read, span, self._count):
                if record.kind in (CUT, *self.LAST):
                    return
                if record.kind in self.READ:
                    refuse_piece(self._where, record.end - record.start)
                    yield from self._taken(read, record)
        if self.LAST:
            self._count("truncated")

    def _taken(self, read: Read, record: Piece) -> Iterator[RawMessage]:
        """Yield the messages in a record, which may be a chunk of records."""
        content = read(record.start, record.end - record.start)
        try:
            if record.kind != self.CHUNK:
                yield from self._content(record, content)
                return
            records, place = self._unpacked(record, content), 0
            inside = reader_of(io.BytesIO(records))
            while place < len(records):
                inner = self.piece_at(inside, place, len(records))
                if inner is None or inner.kind == self.CHUNK:
                    raise DamagedPieceError("a record leads out of its chunk")
                place = inner.end
                yield from self._taken(inside, inner)
        except (struct.error, DamagedPieceError, KeyError):
            self._count("bad_record")

    def piece_at(self, read: Read, place: int, end: int) -> Piece | None:
        """Return the record that begins at a place, or None where there is none."""
        raise NotImplementedError

    def proven(self, read: Read, place: int, end: int) -> int | None:
        """Return where the record begins to which a mark at a place belongs, or None."""
        raise NotImplementedError

    def _content(self, record: Piece, content: bytes) -> Iterator[RawMessage]:
        """Yield the message in a record, or keep what it says of others."""
        raise NotImplementedError

    def _unpacked(self, record: Piece, content: bytes) -> bytes:
        """Return the records in a chunk."""
        raise NotImplementedError


class Mcap(_Bag):
    """An MCAP file."""

    MAGIC = b"\x89MCAP0\r\n"
    SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x03, 0x04, 0x05, 0x06
    READ = (SCHEMA, CHANNEL, MESSAGE, CHUNK)
    LAST = (0x0F, 0x02)  # the end of the data, and the footer
    HEAD, MESSAGE_HEAD, CHUNK_HEAD = map(struct.Struct, ("<BQ", "<2sIQQ", "<QQQI"))
    PROOF_RECORDS = 2  # Records in a row that have to make sense after damage.
    mark = re.compile(rb"(?=[\x01-\x0f].{5}\x00{3})", re.DOTALL)  # shorter than 2^40 bytes

    def piece_at(self, read: Read, place: int, end: int) -> Piece | None:
        """See :class:`_Bag`."""
        head = read(place, self.HEAD.size)
        if len(head) < self.HEAD.size:
            return None
        kind, length = self.HEAD.unpack(head)
        start = place + self.HEAD.size
        return (
            Piece(kind, start, start + length) if 0 < kind < 16 and length <= end - start else None
        )

    def proven(self, read: Read, place: int, end: int) -> int | None:
        """See :class:`_Bag`."""
        at = place
        for _ in range(self.PROOF_RECORDS):
            record = self.piece_at(read, at, end)
            if record is None or record.start == record.end:
                return None
            if record.kind == self.LAST[0]:
                return place
            at = record.end
        return place

    def _content(self, record: Piece, content: bytes) -> Iterator[RawMessage]:
        if record.kind == self.SCHEMA:
            self._types_of[content[:2]] = _text(content, 2)[0]
        elif record.kind == self.CHANNEL:
            topic, place = _text(content, 4)
            self._channels[content[:2]] = topic, content[2:4], _text(content, place)[0]
        else:
            number = self.MESSAGE_HEAD.unpack_from(content)[0]
            topic, schema, encoding = self._channels.get(number, ("", b"", ""))
            kind = self._types_of.get(schema, "")
            if kind in self._types:
                yield RawMessage(topic, content[self.MESSAGE_HEAD.size :], encoding != "ros1", kind)

    def _unpacked(self, record: Piece, content: bytes) -> bytes:
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


class Ros1(_Bag):
    """A ROS 1 bag."""

    MAGIC = b"#ROSBAG V2.0\n"
    MESSAGE, CHUNK, CONNECTION = 0x02, 0x05, 0x07
    READ = (MESSAGE, CHUNK, CONNECTION)
    LENGTH = struct.Struct("<I")
    HEADER_LIMIT_BYTES = 1 << 20  # Longest header that is believed; it holds a topic's name.
    SEARCH_BACK_BYTES = 256  # How far before its field ``op`` a chunk's header is looked for.
    mark = re.compile(rb"\x04\x00\x00\x00op=\x05", re.DOTALL)  # the field that names a chunk

    def piece_at(self, read: Read, place: int, end: int) -> Piece | None:
        """See :class:`_Bag`."""
        try:
            (length,) = self.LENGTH.unpack(read(place, 4))
            if not 0 < length <= min(self.HEADER_LIMIT_BYTES, end - place - 8):
                return None
            fields = _fields(read(place + 4, length))
            start = place + length + 8
            (data_length,) = self.LENGTH.unpack(read(start - 4, 4))
            record = Piece(fields[b"op"][0], start, start + data_length, fields)
        except (struct.error, DamagedPieceError, KeyError, IndexError):
            return None
        return record if record.end <= end else None

    def proven(self, read: Read, place: int, end: int) -> int | None:
        """See :class:`_Bag`."""
        for begin in range(place - 4, max(place - self.SEARCH_BACK_BYTES, 0) - 1, -1):
            record = self.piece_at(read, begin, end)
            if record is not None and record.kind == self.CHUNK:
                return begin
        return None

    def _content(self, record: Piece, content: bytes) -> Iterator[RawMessage]:
        connection = record.fields[b"conn"]
        if record.kind == self.CONNECTION:
            texts = record.fields.get(b"topic", b""), _fields(content)[b"type"]
            topic, kind = (text.decode("utf-8", "replace") for text in texts)
            self._types_of[connection] = kind
            self._channels[connection] = topic, connection, "ros1"
            return
        topic, _, _ = self._channels.get(connection, ("", b"", ""))
        kind = self._types_of.get(connection, "")
        if record.kind == self.MESSAGE and kind in self._types:
            yield RawMessage(topic, content, cdr=False, kind=kind)

    def _unpacked(self, record: Piece, content: bytes) -> bytes:
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
