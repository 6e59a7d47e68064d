"""MCAP files and ROS 1 bags, as raw messages of given types.

Sources: MCAP, "Format Specification" (public): records of an opcode (one byte), a length (eight)
and content. ROS wiki, "Bags/Format/2.0" (public): records of a header with named fields and data.
In both, messages lie in chunks, which may be compressed. Both are read record by record: a damaged
chunk is left out, and what follows it is read.
"""

import io
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from spikingtac.events.formats import pieces
from spikingtac.events.formats.pieces import Count, DamagedPieceError, Piece, Read


class RawMessage(NamedTuple):
    """A message as it was stored; ``cdr`` for ROS 2, else the ROS 1 serialisation."""

    topic: str
    data: bytes
    cdr: bool
    kind: str


class _Bag:
    """What the records of a bag have told.

    Attributes:
        where: A record, for errors.
        types_of: Type of the messages of each schema or connection.
        channels: Topic, schema and whether the messages are CDR, of each channel or connection.
    """

    def __init__(self, path: Path) -> None:
        self.where = f"{str(path)!r}: a record"
        self.types_of: dict[bytes, str] = {}
        self.channels: dict[bytes, tuple[str, bytes, bool]] = {}


class Mcap(_Bag):
    """An MCAP file."""

    MAGIC = b"\x89MCAP0\r\n"
    SCHEMA, CHANNEL, MESSAGE, CHUNK = READ = 0x03, 0x04, 0x05, 0x06
    LAST = (0x0F, 0x02)  # Ends of what is read: the end of the data, and the footer.
    HEAD, MESSAGE_HEAD, CHUNK_HEAD = map(struct.Struct, ("<BQ", "<2sIQQ", "<QQQI"))
    PROOF_RECORDS = 2  # Records in a row that have to make sense after damage.
    MARK = re.compile(rb"(?=[\x01-\x0f].{5}\x00{3})", re.DOTALL)  # shorter than 2^40 bytes

    def piece_at(self, read: Read, place: int, end: int) -> Piece | None:
        """Return the record that begins at a place, or None where there is none."""
        head, start = read(place, self.HEAD.size), place + self.HEAD.size
        if len(head) < self.HEAD.size:
            return None
        kind, length = self.HEAD.unpack(head)
        fits = 0 < kind < 16 and length <= end - start
        return Piece(kind, start, start + length) if fits else None

    def proven(self, read: Read, place: int, end: int) -> int | None:
        """Return a place from which sound records follow, or None where they do not."""
        at = place
        for _ in range(self.PROOF_RECORDS):
            record = self.piece_at(read, at, end)
            if record is None or record.start == record.end:
                return None
            if record.kind == self.LAST[0]:
                return place
            at = record.end
        return place

    def told(self, record: Piece, content: bytes) -> tuple[bytes, bytes] | None:
        """Return channel and data of a message; of other records, keep what they tell."""
        if record.kind == self.SCHEMA:
            self.types_of[content[:2]] = _text(content, 2)[0]
        elif record.kind == self.CHANNEL:
            topic, place = _text(content, 4)
            self.channels[content[:2]] = topic, content[2:4], (_text(content, place)[0] != "ros1")
        else:
            return self.MESSAGE_HEAD.unpack_from(content)[0], content[self.MESSAGE_HEAD.size :]
        return None

    def unpacked(self, record: Piece, content: bytes) -> bytes:
        """Return the records in a chunk."""
        _, _, size, checksum = self.CHUNK_HEAD.unpack_from(content)
        kind, place = _text(content, self.CHUNK_HEAD.size)
        (length,) = struct.unpack_from("<Q", content, place)
        stored = content[place + 8 : place + 8 + length]
        if len(stored) < length:
            raise DamagedPieceError("the chunk ends early")
        records = pieces.decompressed(stored, kind, self.where)
        if len(records) != size or (checksum and zlib.crc32(records) != checksum):
            raise DamagedPieceError("the checksum does not fit")
        return records


class Ros1(_Bag):
    """A ROS 1 bag."""

    MAGIC = b"#ROSBAG V2.0\n"
    MESSAGE, CHUNK, CONNECTION = READ = 0x02, 0x05, 0x07
    LAST = ()
    HEADER_LIMIT_BYTES = 1 << 20  # Longest header that is believed; it holds a topic's name.
    SEARCH_BACK_BYTES = 256  # How far before its field ``op`` a chunk's header is looked for.
    MARK = re.compile(rb"\x04\x00\x00\x00op=\x05", re.DOTALL)  # the field that names a chunk

    def piece_at(self, read: Read, place: int, end: int) -> Piece | None:
        """Return the record that begins at a place, or None where there is none."""
        try:
            (length,) = struct.unpack("<I", read(place, 4))
            if not 0 < length <= min(self.HEADER_LIMIT_BYTES, end - place - 8):
                return None
            fields = _fields(read(place + 4, length))
            start = place + length + 8
            (data_length,) = struct.unpack("<I", read(start - 4, 4))
            record = Piece(fields[b"op"][0], start, start + data_length, fields)
        except (struct.error, DamagedPieceError, KeyError, IndexError):
            return None
        return record if record.end <= end else None

    def proven(self, read: Read, place: int, end: int) -> int | None:
        """Return where the chunk begins whose header names it at a place, or None."""
        for begin in range(place - 4, max(place - self.SEARCH_BACK_BYTES, 0) - 1, -1):
            record = self.piece_at(read, begin, end)
            if record is not None and record.kind == self.CHUNK:
                return begin
        return None

    def told(self, record: Piece, content: bytes) -> tuple[bytes, bytes] | None:
        """Return connection and data of a message; of other records, keep what they tell."""
        connection = record.fields[b"conn"]
        if record.kind == self.CONNECTION:
            texts = record.fields.get(b"topic", b""), _fields(content)[b"type"]
            topic, self.types_of[connection] = (text.decode("utf-8", "replace") for text in texts)
            self.channels[connection] = topic, connection, False
        return (connection, content) if record.kind == self.MESSAGE else None

    def unpacked(self, record: Piece, content: bytes) -> bytes:
        """Return the records in a chunk."""
        kind = record.fields.get(b"compression", b"").decode("latin-1")
        records = pieces.decompressed(content, kind, self.where)
        cut = len(content) < record.end - record.start  # its first records are there
        if not cut and len(records) != struct.unpack("<I", record.fields[b"size"])[0]:
            raise DamagedPieceError("the chunk holds another number of bytes than it says")
        return records


def messages_in(
    bag: Mcap | Ros1, path: Path, types: tuple[str, ...], count: Count
) -> Iterator[RawMessage]:
    """Yield the messages of the given types; damage is counted."""
    form = pieces.Form(bag.MARK, bag.piece_at, bag.proven)
    span = len(bag.MAGIC), path.stat().st_size
    with path.open("rb") as file:
        read = pieces.reader_of(file)
        for record in pieces.walk(form, read, span, count):
            if record.kind == pieces.CUT:  # perhaps a chunk that ends behind the file's end
                most = span[1] + pieces.PIECE_LIMIT_BYTES
                record = bag.piece_at(read, record.start, most) or record
                if record.kind != Ros1.CHUNK or isinstance(bag, Mcap):
                    return
            elif record.kind in bag.LAST:
                return
            if record.kind in bag.READ:
                pieces.refuse_piece(bag.where, record.end - record.start)
                yield from _taken(bag, read, record, types, count)
    if bag.LAST:
        count("truncated")


def _taken(
    bag: Mcap | Ros1, read: Read, record: Piece, types: tuple[str, ...], count: Count
) -> Iterator[RawMessage]:
    """Yield the messages in a record, which may be a chunk of records."""
    content = read(record.start, record.end - record.start)
    try:
        if record.kind != bag.CHUNK:
            number, data = bag.told(record, content) or (b"", b"")
            topic, schema, cdr = bag.channels.get(number, ("", b"", False))
            kind = bag.types_of.get(schema, "")
            if kind in types:
                yield RawMessage(topic, data, cdr, kind)
            return
        records, place = bag.unpacked(record, content), 0
        inside = pieces.reader_of(io.BytesIO(records))
        while place < len(records):
            inner = bag.piece_at(inside, place, len(records))
            if inner is None or inner.kind == bag.CHUNK:
                raise DamagedPieceError("a record leads out of its chunk")
            place = inner.end
            yield from _taken(bag, inside, inner, types, count)
    except (struct.error, DamagedPieceError, KeyError):
        count("bad_record")


def _text(content: bytes, place: int) -> tuple[str, int]:
    """Return a string and where it ends."""
    (length,) = struct.unpack_from("<I", content, place)
    text = content[place + 4 : place + 4 + length]
    if len(text) < length:
        raise DamagedPieceError("a text ends early")
    return text.decode("utf-8", "replace"), place + 4 + length


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
