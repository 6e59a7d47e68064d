"""Prophesee ``.dat`` files of CD events: a text header, two bytes of type, eight bytes an event.

Source: Prophesee, "DAT File Format" (public documentation): 32 bits of time (us), then from the
lowest bit 14 of column, 14 of row, 4 of polarity. Version 1 files hold 9, 8 and 1 bits instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from spikingtac.errors import FormatError
from spikingtac.events.evt.header import RawHeader, read_header
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.events.formats.time_course import unwrapped

CD_TYPES = (0x00, 0x0C)
DAT_EVENT = np.dtype([("t", "<u4"), ("address", "<u4")])
DAT_VERSION = "2"
CHUNK_EVENTS = 1 << 17


class DatSource(FileSource):
    """Events of a ``.dat`` file; the 32-bit time is unwrapped."""

    format = "DAT"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with path.open("rb") as file:
            self._header: RawHeader = read_header(file)
            kind = file.read(2)
            self._start = file.tell()
        if self._header.fields.get("Version", DAT_VERSION) != DAT_VERSION:
            raise FormatError(f"{str(path)!r} is a .dat file of version 1; version 2 is read")
        if len(kind) == 2 and (kind[0] not in CD_TYPES or kind[1] != DAT_EVENT.itemsize):
            raise FormatError(
                f"{str(path)!r} holds events of type {kind[0]:#x} with {kind[1]} bytes each; "
                "CD events (type 0xc, 8 bytes) are read"
            )
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        fields = {key.lower(): value for key, value in self._header.fields.items()}
        width, height = fields.get("width", ""), fields.get("height", "")
        if width.isdigit() and height.isdigit() and int(width) and int(height):
            return int(width), int(height)
        return self._size_from_events()

    def _columns(self) -> Iterator[Rows]:
        epoch_us, last = 0, None
        with self.path.open("rb") as file:
            file.seek(self._start)
            while data := file.read(CHUNK_EVENTS * DAT_EVENT.itemsize):
                usable = len(data) // DAT_EVENT.itemsize * DAT_EVENT.itemsize
                self.losses.add("truncated", int(usable < len(data)))
                events = np.frombuffer(data[:usable], DAT_EVENT)
                t = events["t"].astype(np.int64)
                if len(t):
                    t, epoch_us, last = unwrapped(t, epoch_us, int(t[0]) if last is None else last)
                address = events["address"]
                x, y = address & 0x3FFF, (address >> 14) & 0x3FFF
                yield x.astype(np.int64), y.astype(np.int64), (address >> 28) & 0xF, t
