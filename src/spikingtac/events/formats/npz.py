"""Event ``.npz``: the columns t, x, y, p and size, read and written at constant memory."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import FormatError
from spikingtac.events.formats.array_file import ARCHIVE_DAMAGE, PACKINGS, ColumnFile
from spikingtac.events.formats.checks.time_unit import SECONDS_NOTE, US_PER_S, in_seconds
from spikingtac.events.formats.codec import EventWriter, Triggers
from spikingtac.events.formats.file_source import FileSource, Rows
from spikingtac.file_kinds import told_kind
from spikingtac.types import EventPacket

CHUNK_ROWS = 1 << 17
_TYPES = {"t": np.dtype("<i8"), "x": np.dtype("<u2"), "y": np.dtype("<u2"), "p": np.dtype("?")}


class NpzSource(FileSource):
    """Events of an ``.npz`` with ``t`` (us), ``x``, ``y``, ``p`` and, if it is there, ``size``."""

    format = "NPZ"

    def _size(self) -> tuple[int, int]:
        with self._archive() as archive:
            if "size.npy" not in archive.namelist():
                return self._size_from_events()
            try:
                column = _ColumnReader(archive, "size", self.path)
                if column.length != 2:
                    raise ValueError(f"{column.length} numbers instead of two")
                width, height = (int(value) for value in column.read(2))
            except ARCHIVE_DAMAGE as error:
                raise FormatError(f"{str(self.path)!r}: unfit size: {error}") from error
        return width, height

    def _columns(self) -> Iterator[Rows]:
        with self._archive() as archive:
            columns = [_ColumnReader(archive, name, self.path) for name in ("x", "y", "p", "t")]
            left = min(column.length for column in columns)
            if left < max(column.length for column in columns):
                self.losses.add("truncated")
            seconds: bool | None = None
            while left > 0:
                try:
                    x, y, p, t = (column.read(min(CHUNK_ROWS, left)) for column in columns)
                except ARCHIVE_DAMAGE:
                    self.losses.add("truncated")
                    return
                if seconds is None:
                    seconds = in_seconds(t)
                    if seconds and SECONDS_NOTE not in self.notes:
                        self.notes.append(SECONDS_NOTE)
                yield x, y, p, t * US_PER_S if seconds else t
                left -= CHUNK_ROWS

    def _archive(self) -> zipfile.ZipFile:
        try:
            return zipfile.ZipFile(self.path)
        except ARCHIVE_DAMAGE as error:
            raise FormatError(
                f"{str(self.path)!r} is no readable .npz ({error}); write it again, or open the "
                "recording that it was made from"
            ) from error


class _ColumnReader:
    """Reads one member of an archive in order."""

    def __init__(self, archive: zipfile.ZipFile, name: str, path: Path) -> None:
        try:
            if archive.getinfo(f"{name}.npy").compress_type not in PACKINGS:
                raise ValueError("it is packed by another method than NumPy's")
            self._file: IO[bytes] = archive.open(f"{name}.npy")
            version = np.lib.format.read_magic(self._file)
            read = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            shape, _, self._type = read(self._file)
        except KeyError as error:
            told = told_kind(path) or "an event .npz holds t, x, y, p and size"
            raise FormatError(f"{str(path)!r} has no column {name!r}; {told}") from error
        except ARCHIVE_DAMAGE as error:
            raise FormatError(f"{str(path)!r}: column {name!r} is damaged: {error}") from error
        if len(shape) != 1 or self._type.kind not in "uifb":
            raise FormatError(
                f"{str(path)!r}: column {name!r} is {self._type} of shape {shape}; "
                "one row of numbers is needed"
            )
        self.length = int(shape[0])

    def read(self, count: int) -> NDArray[Any]:
        """Return the next ``count`` numbers.

        Raises:
            EOFError: The member ends before.
        """
        data = self._file.read(count * self._type.itemsize)
        if len(data) < count * self._type.itemsize:
            raise EOFError("the column ends early")
        values = np.frombuffer(data, self._type)
        if self._type.kind == "f":
            return np.nan_to_num(values.astype(np.float64), nan=-1.0, posinf=-1.0, neginf=-1.0)
        return values


class NpzWriter(EventWriter):
    """Writes event ``.npz`` files packet by packet."""

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        self.size = size
        self._file = ColumnFile(path)
        self._file.append({name: np.empty(0, dtype) for name, dtype in _TYPES.items()})
        self._file.set("size", np.array(size, np.int64))

    def write(self, packet: EventPacket) -> None:
        """Append a packet."""
        self._file.append({name: getattr(packet, name) for name in _TYPES})

    def add_triggers(self, triggers: Triggers) -> None:
        """Append trigger edges; the file has their columns only where there are any."""
        if len(triggers):
            self._file.append(
                {
                    "trigger_t_us": triggers.t_us,
                    "trigger_channel": triggers.channel,
                    "trigger_edge": triggers.edge,
                }
            )

    def close(self) -> None:
        """Complete the file; further calls do nothing."""
        self._file.close()

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._file.abandon()
