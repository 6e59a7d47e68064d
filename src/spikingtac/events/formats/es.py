"""Event Stream ``.es`` files (version 2, DVS events).

Source: event_stream, "Specification" (public). An event takes five bytes: seven bits of time since
the last one and the polarity, then column and row. The byte 0xFF adds 127 us, 0xFE fills. Rows
count from the bottom; here they count from the top.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import WholeFile
from spikingtac.errors import FormatError
from spikingtac.events.formats.codec import EventWriter
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.types import EventPacket

SIGNATURE = b"Event Stream"
VERSION = (2, 0, 0)
DVS = 1
OVERFLOW, FILL = 0xFF, 0xFE
OVERFLOW_US = 127
EVENT_BYTES = 5
CHUNK_BYTES = 1 << 18
SILENCE_LIMIT_US = 86_400_000_000
"""Longest pause that is written, one byte for each 127 us: a day."""

_HEADER = struct.Struct("<12s3BBHH")


class EsSource(FileSource):
    """Events of an ``.es`` file of the DVS type."""

    format = "ES"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with path.open("rb") as file:
            data = file.read(_HEADER.size)
        if len(data) < _HEADER.size:
            raise FormatError(f"{str(path)!r} ends within the header of an .es file")
        signature, major, minor, patch, kind, width, height = _HEADER.unpack(data)
        if signature != SIGNATURE or major != VERSION[0]:
            raise FormatError(
                f"{str(path)!r} is Event Stream version {major}.{minor}.{patch}; version 2 is read"
            )
        if kind != DVS or not (width and height):
            raise FormatError(
                f"{str(path)!r} holds events of type {kind} on {width}x{height} px; DVS events "
                "(type 1) are read: convert others with event_stream"
            )
        self._header_size = (width, height)
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        return self._header_size

    def _columns(self) -> Iterator[Rows]:
        from spikingtac.events.formats.es_kernels import decode_kernel

        height = self._header_size[1]
        total = max(self.path.stat().st_size, 1)
        state = np.zeros(1, np.int64)
        tail = b""
        with self.path.open("rb") as file:
            file.seek(_HEADER.size)
            while data := file.read(CHUNK_BYTES):
                buffer = np.frombuffer(tail + data, np.uint8)
                room = len(buffer) // EVENT_BYTES + 1
                x, y = np.empty(room, np.int64), np.empty(room, np.int64)
                p, t = np.empty(room, np.bool_), np.empty(room, np.int64)
                count, end = decode_kernel(buffer, x, y, p, t, state)
                tail = buffer[end:].tobytes()
                self.progress = file.tell() / total
                yield x[:count], height - 1 - y[:count], p[:count], t[:count]
        self.losses.add("truncated", int(bool(tail)))


class EsWriter(EventWriter):
    """Writes ``.es`` files packet by packet."""

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        self.size = size
        self._last_us = 0
        self._target = WholeFile(path)
        self._file = self._target.begin(_HEADER.pack(SIGNATURE, *VERSION, DVS, *size))

    def write(self, packet: EventPacket) -> None:
        """Append a packet.

        Raises:
            FormatError: Time goes back, is negative, or pauses for more than a day.
        """
        steps = np.diff(packet.t, prepend=self._last_us)
        if len(steps) and (steps.min() < 0 or steps.max() > SILENCE_LIMIT_US):
            raise FormatError("an .es file needs times from zero on, in order, without a day's gap")
        self._file.write(_encoded(steps, packet, self.size[1]).tobytes())
        if len(packet):
            self._last_us = int(packet.t[-1])

    def close(self) -> None:
        """Complete the file; further calls do nothing."""
        if not self._file.closed:
            self._target.commit(self._file)

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._target.abandon(self._file)


def _encoded(steps: NDArray[np.int64], packet: EventPacket, height: int) -> NDArray[Any]:
    overflows, rest = np.divmod(steps, OVERFLOW_US)
    starts = np.cumsum(overflows + EVENT_BYTES) - EVENT_BYTES
    out = np.full(int((overflows + EVENT_BYTES).sum()), OVERFLOW, np.uint8)
    row = height - 1 - packet.y.astype(np.int64)
    out[starts] = (rest << 1) | packet.p
    out[starts + 1], out[starts + 2] = packet.x & 0xFF, packet.x >> 8
    out[starts + 3], out[starts + 4] = row & 0xFF, row >> 8
    return out
