"""ROS 1 bags, record by record: a damaged chunk is left out, and what follows it is read.

Source: ROS wiki, "Bags/Format/2.0" (public): records of a header with named fields and data;
messages and connections lie in chunks, which may be compressed.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from spikingtac.events.bags.storages import Count, RawMessage
from spikingtac.events.formats.limits import DamagedPieceError, decompressed, refuse_piece

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, CHUNK, CONNECTION = b"\x02", b"\x05", b"\x07"
LENGTH = struct.Struct("<I")

# Longest header of a record that is believed; a connection's holds a topic's name.
HEADER_LIMIT_BYTES = 1 << 20

SEARCH_BYTES = 1 << 20
SEARCH_BACK_BYTES = 256  # How far before its field ``op`` a chunk's header is looked for.

_CHUNK_FIELD = re.compile(rb"\x04\x00\x00\x00op=\x05", re.DOTALL)

Fields = dict[bytes, bytes]


def ros1_messages(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    """Yield the messages of the given types in the order of their recording.

    Raises:
        FormatError: A piece is larger than the limit.
        MissingExtraError: A chunk's compression needs a library that is not installed.
    """
    end = path.stat().st_size
    reader = _Reader(types, count)
    with path.open("rb") as file:
        place = len(MAGIC)
        while place < end:
            record = _record_at(file, place, end)
            if record is None:
                found = _next_chunk(file, place + 1, end)
                count("truncated" if found is None else "bad_record")
                if found is None:
                    return
                place = found
                continue
            fields, start, length = record
            place = start + length
            if fields.get(b"op") in (CHUNK, MESSAGE, CONNECTION):
                refuse_piece(f"{str(path)!r}: a record", length)
                file.seek(start)
                yield from reader.take(fields, file.read(length), f"{str(path)!r}: a chunk")


class _Reader:
    """Takes records and yields messages; connections are kept."""

    def __init__(self, types: tuple[str, ...], count: Count) -> None:
        self._types, self._count = types, count
        self._connections: dict[bytes, tuple[str, str]] = {}

    def take(self, fields: Fields, data: bytes, where: str) -> Iterator[RawMessage]:
        """Yield the messages in a record; damage is counted."""
        try:
            kind = fields.get(b"op")
            if kind == CHUNK:
                yield from self._chunk(fields, data, where)
            elif kind == CONNECTION:
                topic, about = fields.get(b"topic", b""), _fields(data)
                names = topic.decode("utf-8", "replace"), about[b"type"].decode("utf-8", "replace")
                self._connections[fields[b"conn"]] = names
            elif kind == MESSAGE:
                topic, name = self._connections.get(fields[b"conn"], ("", ""))
                if name in self._types:
                    yield RawMessage(topic, data, cdr=False, kind=name)
        except (struct.error, DamagedPieceError, KeyError):
            self._count("bad_record")

    def _chunk(self, fields: Fields, data: bytes, where: str) -> Iterator[RawMessage]:
        kind = fields.get(b"compression", b"").decode("latin-1")
        records = decompressed(data, kind, where)
        if len(records) != LENGTH.unpack(fields[b"size"])[0]:
            raise DamagedPieceError("the chunk holds another number of bytes than it says")
        place = 0
        while place < len(records):
            header, place = _piece(records, place)
            content, place = _piece(records, place)
            inner = _fields(header)
            if inner.get(b"op") == CHUNK:
                raise DamagedPieceError("a chunk within a chunk")
            yield from self.take(inner, content, where)


def _piece(data: bytes, place: int) -> tuple[bytes, int]:
    """Return the bytes behind a length, and where they end."""
    (length,) = LENGTH.unpack_from(data, place)
    piece = data[place + 4 : place + 4 + length]
    if len(piece) < length:
        raise DamagedPieceError("a record ends early")
    return piece, place + 4 + length


def _fields(header: bytes) -> Fields:
    """Return the fields of a header.

    Raises:
        DamagedPieceError: It does not end where its last field ends, or a field has no name.
    """
    found, place = {}, 0
    while place < len(header):
        field, place = _piece(header, place)
        name, equals, value = field.partition(b"=")
        if not (name and equals):
            raise DamagedPieceError("a field without a name")
        found[name] = value
    return found


def _record_at(file: BinaryIO, place: int, end: int) -> tuple[Fields, int, int] | None:
    """Return fields, start and length of the data of the record at a place, or None."""
    try:
        file.seek(place)
        (length,) = LENGTH.unpack(file.read(4))
        if not 0 < length <= min(HEADER_LIMIT_BYTES, end - place - 8):
            return None
        fields = _fields(file.read(length))
        (data_length,) = LENGTH.unpack(file.read(4))
    except (struct.error, DamagedPieceError):
        return None
    start = place + length + 8
    return (fields, start, data_length) if b"op" in fields and data_length <= end - start else None


def _next_chunk(file: BinaryIO, place: int, end: int) -> int | None:
    """Return where the next chunk begins, or None where the rest holds none."""
    while place < end:
        file.seek(place)
        data = file.read(SEARCH_BYTES + len(MAGIC))
        for match in _CHUNK_FIELD.finditer(data):
            field = place + match.start()
            for begin in range(field - 4, max(field - SEARCH_BACK_BYTES, place) - 1, -1):
                record = _record_at(file, begin, end)
                if record is not None and record[0].get(b"op") == CHUNK:
                    return begin
        place += SEARCH_BYTES
    return None
