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
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import FormatError
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows

MAJOR, DVS = 2, 1
OVERFLOW, FILL, OVERFLOW_US = 0xFF, 0xFE, 127
EVENT_BYTES = 5
CHUNK_BYTES = 1 << 18
_HEADER = struct.Struct("<12s3BBHH")


class EsSource(FileSource):
    """Events of an ``.es`` file of the DVS type."""

    format = "ES"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with path.open("rb") as file:
            data = file.read(_HEADER.size)
        if len(data) < _HEADER.size:
            raise FormatError(f"{str(path)!r} ends within the header of an .es file")
        _, major, minor, patch, kind, width, height = _HEADER.unpack(data)
        if major != MAJOR:
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


@njit(cache=True, nogil=True)
def decode_kernel(
    data: NDArray[np.uint8],
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    p: NDArray[np.bool_],
    t: NDArray[np.int64],
    state: NDArray[np.int64],
) -> tuple[Any, Any]:
    """Decode whole events; return their number and the bytes used. ``state`` is the time, us."""
    n, i = 0, 0
    while i < len(data):
        first = np.int64(data[i])
        if first == OVERFLOW:
            state[0] += OVERFLOW_US
            i += 1
        elif first == FILL:
            i += 1
        elif i + 5 <= len(data):
            state[0] += first >> 1
            x[n] = np.int64(data[i + 1]) | (np.int64(data[i + 2]) << 8)
            y[n] = np.int64(data[i + 3]) | (np.int64(data[i + 4]) << 8)
            p[n], t[n] = (first & 1) == 1, state[0]
            n += 1
            i += 5
        else:
            break
    return n, i
