"""NumPy files of events: columns, structured rows or tables in ``.npz`` and ``.npy``."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import FormatError
from spikingtac.events.formats.array_file import ARCHIVE_DAMAGE, open_member, read_array_header
from spikingtac.events.formats.codec import TRIGGERS
from spikingtac.events.formats.columns import (
    CHUNK_ROWS,
    TABLE_WIDTHS,
    Order,
    TableSource,
    order_named,
    order_of_values,
    rows_of,
)
from spikingtac.events.formats.file_source import ReadOptions, Rows
from spikingtac.events.formats.packing import Counter
from spikingtac.events.formats.pieces import refuse_piece
from spikingtac.file_kinds import told_kind
from spikingtac.types import LossCounters

_SIZES = ("size", "resolution", "sensor_size")

# The GenX320 recorder of OpenMV boards (openmv-genx320-recorder, MIT) writes rows of type (1 ON,
# 0 OFF, else no event), seconds, milliseconds, microseconds, x and y.
OPENMV_COLUMNS = 6
OPENMV_SECONDS = 1 << 16  # The seconds are 16 bits wide: they wrap after 18 hours.
GENX320_SIZE = (320, 320)


class ArraySource(TableSource):
    """Events of an ``.npz`` with one array for each column, or of one array of structures or rows.

    Raises:
        FormatError: The file is damaged, or holds no columns of time, x, y and polarity.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.format = "NPY" if _starts_npy(path) else "NPZ"
        self._order: Order | None = None
        with _Arrays(path) as arrays:
            self._members = _event_members(arrays, path)
            first = arrays.open(self._members[0])
            self._openmv = first.width == OPENMV_COLUMNS and first.type.kind == "u"
            if self._openmv:
                self.format, self._named_size = "OpenMV NPZ", GENX320_SIZE
            else:
                self._order = _order_of(arrays, self._members, path)
                self._unit = self._order.unit
            self._named_size = _size_in(arrays, path) or self._named_size
        super().__init__(path, options)

    def _rows(self) -> Iterator[Rows]:
        with _Arrays(self.path) as arrays:
            self._take_triggers(arrays)
            pieces = self._pieces([arrays.open(name) for name in self._members])
            if self._openmv:
                yield from _openmv_rows((read[0] for read in pieces), self.losses)
            for read in pieces:
                if len(read) == 1 and self._order is not None:
                    yield rows_of(read[0], self._order.place)
                else:
                    x, y, p, t = read
                    yield x, y, p, t

    def _pieces(self, members: list[_Array]) -> Iterator[list[NDArray[Any]]]:
        """Yield some rows of each array, as far as all of them reach."""
        lengths = [member.length for member in members]
        self.losses.add("truncated", int(min(lengths) < max(lengths)))
        total = min(lengths)
        for first in range(0, total, CHUNK_ROWS):
            try:
                read = [member.read(min(CHUNK_ROWS, total - first)) for member in members]
            except ARCHIVE_DAMAGE:
                self.losses.add("truncated")
                return
            self.progress = min(first + CHUNK_ROWS, total) / total
            yield read

    def _take_triggers(self, arrays: _Arrays) -> None:
        if not set(TRIGGERS) <= set(arrays.names):
            return
        try:
            columns = [arrays.open(name) for name in TRIGGERS]
            self.triggers.append(*(column.read(column.length) for column in columns))
        except (*ARCHIVE_DAMAGE, FormatError):
            self.losses.add("truncated")


class _Arrays(ExitStack):
    """The arrays of an ``.npz`` or ``.npy``, each read in order; a context that closes them."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path, self._archive, self.names = path, None, [""]
        if _starts_npy(path):
            return
        try:
            self._archive = self.enter_context(zipfile.ZipFile(path))
        except ARCHIVE_DAMAGE as error:
            raise FormatError(
                f"{str(path)!r} is no readable .npz ({error}); write it again, or open the "
                "recording that it was made from"
            ) from error
        names = self._archive.namelist()
        self.names = [name.removesuffix(".npy") for name in names if name.endswith(".npy")]

    def open(self, name: str) -> _Array:
        """Return an array's reader at its beginning."""
        try:
            if self._archive is None:
                return _Array(self.enter_context(self._path.open("rb")))
            return _Array(self.enter_context(open_member(self._archive, f"{name}.npy")))
        except ARCHIVE_DAMAGE as error:
            where = f"{str(self._path)!r}" + (f": column {name!r}" if name else "")
            raise FormatError(f"{where} is damaged: {error}") from error


class _Array:
    """Reads the rows of one array in order.

    Attributes:
        length: Number of rows.
        width: Columns of a table; 0 for a single row of numbers or structures.
        type: Type of a number or structure.
        plain: Whether it is a row or table of numbers or structures.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self._whole, self._at = file, None, 0
        shape, by_column, self.type = read_array_header(file)
        across = len(shape) == 2 and shape[0] in TABLE_WIDTHS and shape[1] > shape[0]
        self.length = int(shape[across]) if shape else 0
        self.width = int(shape[not across]) if len(shape) == 2 else 0
        self.plain = len(shape) in (1, 2) and (self.type.kind in "uifb" or bool(self.type.names))
        self._row_bytes = self.type.itemsize * max(self.width, 1)
        if self.plain and len(shape) == 2 and by_column != across:
            size = math.prod(shape) * self.type.itemsize
            refuse_piece("a table by columns", size)
            self._whole = np.frombuffer(self._exactly(size), self.type).reshape(self.width, -1).T

    def read(self, count: int) -> NDArray[Any]:
        """Return the next ``count`` rows; raises EOFError where the array ends before."""
        if self._whole is not None:
            rows = self._whole[self._at : self._at + count]
            self._at += count
            return rows
        values = np.frombuffer(self._exactly(count * self._row_bytes), self.type)
        values = values.reshape(count, self.width) if self.width else values
        if self.type.kind == "f":
            return np.nan_to_num(values.astype(np.float64), nan=-1.0, posinf=-1.0, neginf=-1.0)
        return values

    def _exactly(self, size: int) -> bytes:
        data = self._file.read(size)
        if len(data) < size:
            raise EOFError("the array ends early")
        return data


def _openmv_rows(tables: Iterable[NDArray[Any]], losses: LossCounters) -> Iterator[Rows]:
    """Yield the columns of an OpenMV board's rows that are events; count the others."""
    seconds = Counter(OPENMV_SECONDS)
    for table in tables:
        events = table[table[:, 0] <= 1].astype(np.int64)
        losses.add("vendor_word", len(table) - len(events))
        t = seconds.unwrapped(events[:, 1]) * 1_000_000 + events[:, 2] * 1_000 + events[:, 3]
        yield events[:, 4], events[:, 5], events[:, 0] == 1, t


def _starts_npy(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(6) == b"\x93NUMPY"


def _event_members(arrays: _Arrays, path: Path) -> list[str]:
    """Return the arrays that hold the events: four columns, or one array of rows."""
    order = order_named(arrays.names)
    if order is not None:
        return [arrays.names[order.place[role]] for role in "xypt"]
    told = told_kind(path)
    others = [name for name in arrays.names if name not in (*TRIGGERS, *_SIZES)]
    rows = [name for name in others if told is None and _holds_rows(arrays, name)]
    if len(rows) == 1:
        return rows
    told = told or (
        f"it holds {', '.join(arrays.names) or 'no array'}; an event .npz holds t, x, y, p and "
        "size, or one array of events"
    )
    raise FormatError(f"{str(path)!r} has no columns of time, x, y and polarity; {told}")


def _holds_rows(arrays: _Arrays, name: str) -> bool:
    try:
        array = arrays.open(name)
    except FormatError:
        return False
    wide = array.width in TABLE_WIDTHS or (name == "events" and array.width == OPENMV_COLUMNS)
    return array.plain and (wide or bool(array.type.names))


def _order_of(arrays: _Arrays, members: list[str], path: Path) -> Order:
    if len(members) > 1:
        for name in members:
            array = arrays.open(name)
            if array.width or array.type.names or not array.plain:
                raise FormatError(
                    f"{str(path)!r}: column {name!r} is {array.type}; one row of numbers is needed"
                )
        unit = order_named(members)
        return Order(place={role: k for k, role in enumerate("xypt")}, unit=unit and unit.unit)
    array = arrays.open(members[0])
    if array.type.names:
        order = order_named(array.type.names)
        if order is None:
            raise FormatError(
                f"{str(path)!r} holds structures of {', '.join(array.type.names)}; fields of "
                "time, x, y and polarity are needed"
            )
        return order
    try:
        sample = array.read(min(array.length, CHUNK_ROWS))
    except ARCHIVE_DAMAGE as error:
        raise FormatError(f"{str(path)!r} is damaged: {error}") from error
    if not len(sample):
        raise FormatError(f"{str(path)!r} holds no events: nothing was recorded into it")
    return order_of_values([sample], repr(str(path)))


def _size_in(arrays: _Arrays, path: Path) -> tuple[int, int] | None:
    for name in _SIZES:
        if name in arrays.names:
            array = arrays.open(name)
            try:
                if array.length != 2 or array.width or array.type.kind not in "uif":
                    raise ValueError(f"{array.length} numbers instead of two")
                width, height = (int(value) for value in array.read(2))
            except ARCHIVE_DAMAGE as error:
                raise FormatError(f"{str(path)!r}: unfit size: {error}") from error
            return width, height
    return None
