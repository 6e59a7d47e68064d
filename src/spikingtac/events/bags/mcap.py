"""MCAP files, record by record: a damaged chunk is left out, and what follows it is read.

Source: MCAP, "Format Specification" (public): records of an opcode (one byte), a length (eight) and
content; messages lie in chunks, which are compressed and carry a checksum.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from spikingtac.events.bags.storages import Count, RawMessage
from spikingtac.events.formats.limits import DamagedPieceError, decompressed, refuse_piece

MAGIC_BYTES = 8
HEAD = struct.Struct("<BQ")
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
KNOWN = range(0x01, 0x10)
MESSAGE_HEAD = struct.Struct("<HIQQ")
CHUNK_HEAD = struct.Struct("<QQQI")
PROOF_RECORDS = 2  # Records in a row that have to make sense where reading goes on after damage.

SEARCH_BYTES = 1 << 20

# Where a record shorter than 2^40 bytes may begin.
_RECORD = re.compile(rb"(?=[\x01-\x0f].{5}\x00{3})", re.DOTALL)


class _Channel(NamedTuple):
    topic: str
    schema: int
    encoding: str


class _Reader:
    """Takes records and yields messages; schemas and channels are kept."""

    def __init__(self, types: tuple[str, ...], count: Count, where: str) -> None:
        self._types, self._count, self._where = types, count, where
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, _Channel] = {}

    def take(self, opcode: int, content: bytes) -> Iterator[RawMessage]:
        """Yield the messages in a record; damage is counted."""
        try:
            if opcode == CHUNK:
                yield from self._chunk(content)
            elif opcode == MESSAGE:
                channel, _, _, _ = MESSAGE_HEAD.unpack_from(content)
                known = self._channels.get(channel)
                kind = self._schemas.get(known.schema, "") if known is not None else ""
                if known is not None and kind in self._types:
                    data = content[MESSAGE_HEAD.size :]
                    yield RawMessage(known.topic, data, known.encoding != "ros1", kind)
            elif opcode == SCHEMA:
                (number,) = struct.unpack_from("<H", content)
                self._schemas[number] = _text(content, 2)[0]
            elif opcode == CHANNEL:
                number, schema = struct.unpack_from("<HH", content)
                topic, place = _text(content, 4)
                self._channels[number] = _Channel(topic, schema, _text(content, place)[0])
        except (struct.error, DamagedPieceError):
            self._count("bad_record")

    def _chunk(self, content: bytes) -> Iterator[RawMessage]:
        _, _, size, checksum = CHUNK_HEAD.unpack_from(content)
        kind, place = _text(content, CHUNK_HEAD.size)
        (length,) = struct.unpack_from("<Q", content, place)
        stored = content[place + 8 : place + 8 + length]
        if len(stored) < length:
            raise DamagedPieceError("the chunk ends early")
        records = decompressed(stored, kind, self._where)
        if len(records) != size or (checksum and zlib.crc32(records) != checksum):
            raise DamagedPieceError("the checksum does not fit")
        place = 0
        while place < len(records):
            inner, length = HEAD.unpack_from(records, place)
            place += HEAD.size
            if inner == CHUNK or place + length > len(records):
                raise DamagedPieceError("a record leads out of its chunk")
            yield from self.take(inner, records[place : place + length])
            place += length


def mcap_messages(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    """Yield the messages of the given types in the order of their recording.

    Raises:
        FormatError: A piece is larger than the limit.
        MissingExtraError: A chunk's compression needs a library that is not installed.
    """
    end = path.stat().st_size
    reader = _Reader(types, count, f"{str(path)!r}: a chunk")
    with path.open("rb") as file:
        place = MAGIC_BYTES
        while place < end:
            record = _record_at(file, place, end)
            if record is None:
                found = _next_record(file, place + 1, end)
                count("truncated" if found is None else "bad_record")
                if found is None:
                    return
                place = found
                continue
            kind, length = record
            if kind in (DATA_END, FOOTER):
                return
            place += HEAD.size
            if kind in (SCHEMA, CHANNEL, MESSAGE, CHUNK):
                refuse_piece(f"{str(path)!r}: a record", length)
                file.seek(place)
                yield from reader.take(kind, file.read(length))
            place += length
        count("truncated")


def _record_at(file: BinaryIO, place: int, end: int) -> tuple[int, int] | None:
    """Return opcode and length of the record that begins at a place, or None."""
    file.seek(place)
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    kind, length = HEAD.unpack(head)
    return (kind, length) if kind in KNOWN and length <= end - place - HEAD.size else None


def _next_record(file: BinaryIO, place: int, end: int) -> int | None:
    """Return where the next records in a row begin, or None where the rest holds none."""
    while place < end:
        file.seek(place)
        data = file.read(SEARCH_BYTES + HEAD.size)
        for match in _RECORD.finditer(data):
            if match.start() < SEARCH_BYTES and _proven(file, place + match.start(), end):
                return place + match.start()
        place += SEARCH_BYTES
    return None


def _proven(file: BinaryIO, place: int, end: int) -> bool:
    for _ in range(PROOF_RECORDS):
        record = _record_at(file, place, end)
        if record is None or record[1] == 0:
            return False
        place += HEAD.size + record[1]
        if record[0] == DATA_END:
            return True
    return True


def _text(content: bytes, place: int) -> tuple[str, int]:
    """Return a string and where it ends."""
    (length,) = struct.unpack_from("<I", content, place)
    text = content[place + 4 : place + 4 + length]
    if len(text) < length:
        raise DamagedPieceError("a text ends early")
    return text.decode("utf-8", "replace"), place + 4 + length
