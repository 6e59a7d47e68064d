"""The ``.npz`` of OpenMV's GenX320 recorders: ``events (n, 6) uint16`` and nothing else is read.

Source: ``openmv-genx320-recorder`` (MIT), its README: columns type (1 ON, 0 OFF), seconds,
milliseconds, microseconds, x and y. The ``metadata`` beside them is a pickled object and is left
alone: unpickling a file runs what stands in it.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import FormatError
from spikingtac.events.formats.array_file import ARCHIVE_DAMAGE
from spikingtac.events.formats.file_source import FileSource, Rows

MEMBER = "events.npy"
COLUMNS = 6
OFF, ON = 0, 1
CHUNK_ROWS = 1 << 16
SECONDS_LIMIT = 1 << 16
"""The seconds are 16 bits wide: they wrap after 18 hours."""
US_PER_S, US_PER_MS = 1_000_000, 1_000
GENX320_SIZE = (320, 320)


def is_openmv(path: Path) -> bool:
    """Return whether an archive holds OpenMV's events instead of columns."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except ARCHIVE_DAMAGE:
        return False
    return MEMBER in names and "t.npy" not in names


class OpenMvNpzSource(FileSource):
    """Events of a GenX320 as an OpenMV board decodes them; other words are passed over."""

    format = "OpenMV NPZ"
    _wraps = 0
    _last_s = 0

    def _size(self) -> tuple[int, int]:
        return GENX320_SIZE

    def _columns(self) -> Iterator[Rows]:
        with zipfile.ZipFile(self.path) as archive, archive.open(MEMBER) as file:
            count, kind = self._header(file)
            row_bytes = COLUMNS * kind.itemsize
            self._wraps = self._last_s = 0
            for first in range(0, count, CHUNK_ROWS):
                self.progress = first / count
                wanted = min(CHUNK_ROWS, count - first)
                try:
                    data = file.read(wanted * row_bytes)
                except ARCHIVE_DAMAGE:
                    data = b""
                rows = np.frombuffer(data[: len(data) // row_bytes * row_bytes], kind)
                yield self._events(rows.reshape(-1, COLUMNS).astype(np.int64))
                if len(data) < wanted * row_bytes:
                    self.losses.add("truncated")
                    return

    def _header(self, file: IO[bytes]) -> tuple[int, np.dtype[Any]]:
        """Return the number of rows and the type of a number."""
        try:
            version = np.lib.format.read_magic(file)
            read = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            shape, by_column, kind = read(file)
        except ARCHIVE_DAMAGE as error:
            raise FormatError(f"{str(self.path)!r}: {MEMBER} is damaged: {error}") from error
        if len(shape) != 2 or shape[1] != COLUMNS or kind.kind != "u" or by_column:
            raise FormatError(
                f"{str(self.path)!r}: events is {kind} of shape {shape}; an OpenMV recording "
                "has unsigned rows of type, s, ms, us, x, y (histograms hold no events)"
            )
        return shape[0], kind

    def _events(self, rows: NDArray[np.int64]) -> Rows:
        events = rows[(rows[:, 0] == OFF) | (rows[:, 0] == ON)]
        self.losses.add("vendor_word", len(rows) - len(events))
        seconds = events[:, 1] + self._wraps * SECONDS_LIMIT
        falls = np.diff(seconds, prepend=self._last_s) < -(SECONDS_LIMIT // 2)
        seconds = seconds + np.cumsum(falls) * SECONDS_LIMIT
        if len(events):
            self._wraps, self._last_s = self._wraps + int(falls.sum()), int(seconds[-1])
        t = seconds * US_PER_S + events[:, 2] * US_PER_MS + events[:, 3]
        return events[:, 4], events[:, 5], events[:, 0] == ON, t
