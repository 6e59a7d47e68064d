"""NumPy files of events: columns, structured rows or tables in ``.npz`` and ``.npy``."""

import io
import math
import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import FormatError
from spikingtac.events.formats import columns
from spikingtac.events.formats.array_file import open_member, read_array_header
from spikingtac.events.formats.codec import TRIGGERS
from spikingtac.events.formats.columns import CHUNK_ROWS, ROLES, TABLE_WIDTHS, Order, Table
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.formats.packing import Counter
from spikingtac.events.formats.pieces import refuse_piece
from spikingtac.file_kinds import ARCHIVE_DAMAGE, told_kind

_SIZES = ("size", "resolution", "sensor_size")

# The GenX320 recorder of OpenMV boards (openmv-genx320-recorder, MIT) writes rows of type (1 ON,
# 0 OFF, else no event), seconds, milliseconds, microseconds, x and y.
OPENMV_COLUMNS = columns.WIDEST_TABLE
OPENMV_SECONDS = 1 << 16  # The seconds are 16 bits wide: they wrap after 18 hours.
GENX320_SIZE = (320, 320)


class ArrayReader:
    """Reads the rows of one array in order.

    Args:
        file: Where its ``.npy`` begins.
        size: Length of the file, bytes.

    Attributes:
        claimed: Number of rows that it should have.
        length: Number of rows that the file holds.
        width: Columns of a table; 0 for a single row of numbers or structures.
        type: Type of a number or structure.
        plain: Whether it is a row or table of numbers or structures.
    """

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file = file
        shape, by_column, self.type = read_array_header(file)
        self.claimed, self.width, across = columns.laid_out(shape)
        fields = self.type.fields or {"": (self.type,)}
        flat = 0 < len(shape) <= 2 and not (self.type.names and self.width)
        self.plain = flat and all(f[0].kind in "uifb" for f in fields.values())
        self._row_bytes = max(self.type.itemsize, 1) * max(self.width, 1)
        self.length = min(self.claimed, (size - file.tell()) // self._row_bytes)
        if self.plain and self.width and by_column != across:
            whole = math.prod(shape) * self.type.itemsize
            refuse_piece("a table by columns", whole)
            columns_first = np.frombuffer(self._exactly(whole), self.type).reshape(self.width, -1)
            self._file = io.BytesIO(columns_first.T.tobytes())

    def read(self, count: int) -> NDArray[Any]:
        """Return the next ``count`` rows; raises EOFError where the array ends before."""
        values = np.frombuffer(self._exactly(count * self._row_bytes), self.type)
        values = values.reshape(count, self.width) if self.width else values
        return values.astype(np.float64) if self.type.kind == "f" else values

    def _exactly(self, size: int) -> bytes:
        data = self._file.read(size)
        if len(data) < size:
            raise EOFError("the array ends early")
        return data


class ArraySource(columns.TableSource):
    """Events of an ``.npz`` with one array for each column, or of one array of structures or rows.

    Raises:
        FormatError: The file is damaged, or holds no columns of time, x, y and polarity.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with path.open("rb") as file:
            self._single = file.read(6) == b"\x93NUMPY"
        self.path, self.format = path, "NPY" if self._single else "NPZ"
        with ExitStack() as files:
            arrays = self._opened(files)
            try:
                self._members = self._event_members(arrays)
                first = arrays(self._members[0])
                self._openmv = first.width == OPENMV_COLUMNS and first.type.kind == "u"
                if self._openmv:
                    self.format, self._named_size = "OpenMV NPZ", GENX320_SIZE
                self._order = self._order_of(first, arrays)
                self._named_size = self._size_in(arrays) or self._named_size
            except ARCHIVE_DAMAGE as error:
                raise FormatError(f"{str(path)!r} is damaged: {error}") from error
        super().__init__(path, options)

    def _opened(self, files: ExitStack) -> Callable[[str], ArrayReader]:
        """Return what gives an array's reader at its beginning; its files are closed at the end."""
        archive: zipfile.ZipFile | None = None
        self._names = [""]
        if not self._single:
            try:
                archive = files.enter_context(zipfile.ZipFile(self.path))
            except ARCHIVE_DAMAGE as error:
                raise FormatError(
                    f"{str(self.path)!r} is no readable .npz ({error}); write it again, or open "
                    "the recording that it was made from"
                ) from error
            members = archive.namelist()
            self._names = [name.removesuffix(".npy") for name in members if name.endswith(".npy")]

        def opened(name: str) -> ArrayReader:
            try:
                file = open_member(archive, f"{name}.npy") if archive else self.path.open("rb")
                of_file = archive.getinfo(f"{name}.npy").file_size if archive else None
                return ArrayReader(files.enter_context(file), of_file or self.path.stat().st_size)
            except ARCHIVE_DAMAGE as error:
                where = f"{str(self.path)!r}" + (f": column {name!r}" if name else "")
                raise FormatError(f"{where} is damaged: {error}") from error

        return opened

    def _event_members(self, arrays: Callable[[str], ArrayReader]) -> list[str]:
        """Return the arrays that hold the events: four columns, or one array of rows."""
        order = columns.order_named(self._names)
        if order is not None:
            return [self._names[index] for index in order.place.values()]
        told, rows = told_kind(self.path), []
        others = [name for name in self._names if name not in (*TRIGGERS, *_SIZES)]
        for name in others if told is None else ():
            with suppress(FormatError) if len(self._names) > 1 else nullcontext():
                array = arrays(name)
                widths = (*TABLE_WIDTHS, OPENMV_COLUMNS) if name == "events" else TABLE_WIDTHS
                if array.plain and (array.width in widths or array.type.names):
                    rows.append(name)
        rows = [name for name in rows if "event" in name.lower()] or rows
        if len(rows) == 1:
            return rows
        told = told or (
            f"it holds {', '.join(self._names) or 'no such array'}; an event .npz holds t, x, y, p "
            "and size, or one array of events"
        )
        raise FormatError(f"{str(self.path)!r} has no columns of time, x, y and polarity; {told}")

    def _order_of(self, first: ArrayReader, arrays: Callable[[str], ArrayReader]) -> Order:
        """Return the order of the columns: of several arrays, or of one of structures or rows."""
        where, names = repr(str(self.path)), first.type.names
        for name in self._members if len(self._members) > 1 else ():
            array = arrays(name)
            if array.width or array.type.names or not array.plain:
                raise FormatError(
                    f"{where}: column {name!r} is {array.type}; one row of numbers is needed"
                )
        if self._openmv:
            return Order({role: index for index, role in enumerate(ROLES)})
        if order := columns.order_named(names or self._members):
            return order
        if names:
            raise FormatError(
                f"{where} holds structures of {', '.join(names)}; fields of time, x, y and "
                "polarity are needed"
            )
        return columns.order_of_values([first.read(min(first.length, CHUNK_ROWS))], where)

    def _size_in(self, arrays: Callable[[str], ArrayReader]) -> tuple[int, int] | None:
        for name in [name for name in _SIZES if name in self._names]:
            array = arrays(name)
            if array.length != 2 or array.width or array.type.kind not in "uif":
                raise ValueError(f"{name} holds {array.length} numbers instead of two")
            width, height = (int(value) for value in array.read(2))
            return width, height
        return None

    def _tables(self) -> Iterator[Table]:
        with ExitStack() as files:
            arrays = self._opened(files)
            if set(TRIGGERS) <= set(self._names):
                try:
                    edges = [arrays(name) for name in TRIGGERS]
                    self.triggers.append(*(column.read(column.length) for column in edges))
                except (*ARCHIVE_DAMAGE, FormatError):
                    self.losses.add("truncated")
            members = [arrays(name) for name in self._members]
            total, seconds = min(member.length for member in members), Counter(OPENMV_SECONDS)
            self.losses.add("truncated", int(total < max(member.claimed for member in members)))
            for first in range(0, total, CHUNK_ROWS):
                try:
                    read = [member.read(min(CHUNK_ROWS, total - first)) for member in members]
                except ARCHIVE_DAMAGE:
                    self.losses.add("truncated")
                    return
                self.progress = min(first + CHUNK_ROWS, total) / total
                if self._openmv:
                    yield self._openmv_columns(read[0], seconds)
                else:
                    yield read if len(read) > 1 else read[0]

    def _openmv_columns(self, table: NDArray[Any], seconds: Counter) -> list[NDArray[Any]]:
        """Return the columns of an OpenMV board's rows that are events; count the others."""
        events = table[table[:, 0] <= 1].astype(np.int64)
        self.losses.add("vendor_word", len(table) - len(events))
        t = seconds.unwrapped(events[:, 1]) * 1_000_000 + events[:, 2] * 1_000 + events[:, 3]
        return [events[:, 4], events[:, 5], events[:, 0] == 1, t]
