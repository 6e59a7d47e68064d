"""HDF5 files of events: OpenEB, v2e, MVSEC, M3ED, DSEC, and any group or table of x, y, p and t.

A truncated file cannot be read at all: record RAW, archive HDF5. Links are not followed, and claims
are weighed against the stored bytes.
"""

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spikingtac.errors import FormatError, MissingExtraError, SpikingTacError, import_extra
from spikingtac.events.formats import columns
from spikingtac.events.formats.columns import CHUNK_ROWS, ROLES, TABLE_WIDTHS, Order, Table
from spikingtac.events.formats.file_source import ReadOptions, chosen_sensor
from spikingtac.events.formats.packing import TIME_LIMIT_US
from spikingtac.events.formats.pieces import PIECE_LIMIT_BYTES, refuse_piece
from spikingtac.file_kinds import ARCHIVE_DAMAGE

DAMAGE = (*ARCHIVE_DAMAGE, IndexError, AttributeError)  # What h5py raises on damaged files.
ECF_FILTER = 0x8ECF  # Prophesee's compression, which hdf5plugin does not bring.
TRIGGERS = "EXT_TRIGGER/events"
ROW_LIMIT_BYTES = 1 << 10  # Longest row of a table that is read; an event takes 16.
OBJECTS_LIMIT = 1 << 12  # Groups and data sets that are looked at.
# Most that compression is believed to gain (deflate cannot exceed 1,032), and the stored bytes
# below which no claim is weighed against them.
COMPRESSION_LIMIT, LEAST_STORED_BYTES = 2_000, 1 << 14
TIME_LIMIT_S = 20.0  # Longest search for attributes, s: a sound file needs 0.3 s.

# Prints, as JSON, attributes that tell a size, Metavision's, this package's and DSEC's, or a unit.
_ATTRIBUTES = """
import h5py, json, sys
names = ("geometry", "width", "height", "sensor_resolution", "units", "unit")
with h5py.File(sys.argv[1], "r") as file:
    every = [file[name].attrs for name in sys.argv[2:]]
    found = [{name: at[name] for name in names if name in at} for at in every]
plain = lambda v: str(v, "utf-8") if isinstance(v, bytes) else getattr(v, "tolist", v.__str__)()
print(json.dumps(found, default=plain))
"""


class _Stream(NamedTuple):
    """The events of one camera: their group, the places of the columns or of one table of them."""

    group: str
    places: tuple[str, ...]
    order: Order | None = None  # None where the values of a table decide it.


class Hdf5Source(columns.TableSource):
    """Events of one camera in an HDF5 file.

    Raises:
        MissingExtraError: The library h5py is not installed, or the compression is Prophesee's ECF.
        FormatError: The file holds no events, cannot be read, or leads to other files.
    """

    format = "HDF5"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with _opened(path) as file:
            try:
                streams = _streams(file, path)
                names = [stream.places[0].rpartition("/")[0] or "/" for stream in streams]
                self._stream = streams[chosen_sensor(names, options.sensor, path)]
                for place in self._stream.places:
                    _require_plain(file[place], path)
                order = self._stream.order or self._order_by_values(file, path)
                told = read_attributes(path, ["/", self._stream.group, *self._stream.places])
                self._order = order._replace(unit=order.unit or _unit(told))
                self._named_size = _size(file, told, self._stream.group)
            except DAMAGE as error:
                if isinstance(error, SpikingTacError):
                    raise
                raise FormatError(f"{str(path)!r} is damaged: {error}") from error
        super().__init__(path, options)

    def _order_by_values(self, file: Any, path: Path) -> Order:
        """Return the order of a table of numbers; v2e's where the values leave it open."""
        table = file[self._stream.places[0]]
        sample = _slice(path, table, slice(0, CHUNK_ROWS))
        try:
            return columns.order_of_values([sample], repr(str(path)))
        except FormatError:
            if table.dtype != np.uint32 or len(ROLES) not in table.shape:
                raise
            return Order({"t": 0, "x": 1, "y": 2, "p": 3})

    def _tables(self) -> Iterator[Table]:
        with _opened(self.path) as file:
            try:
                sets = [file[place] for place in self._stream.places]
                lengths = [_length(dataset) for dataset in sets]
                offset_us = _offset_us(file, self._stream.group)
            except DAMAGE:
                self.losses.add("bad_record")
                return
            self._take_triggers(file)
            total = min(lengths)
            self.losses.add("truncated", int(total < max(lengths)))
            self.losses.add("bad_record", int(offset_us is None))
            self._offset_us = offset_us or 0
            for first in range(0, total, CHUNK_ROWS):
                rows = slice(first, min(first + CHUNK_ROWS, total))
                self.progress = rows.stop / total
                try:
                    read = [_slice(self.path, dataset, rows) for dataset in sets]
                    yield read if len(read) > 1 else read[0]
                except DAMAGE as error:
                    if isinstance(error, MissingExtraError):
                        raise
                    self.losses.add("bad_record")

    def _take_triggers(self, file: Any) -> None:
        try:
            if TRIGGERS in file and len(file[TRIGGERS]):
                _require_plain(file[TRIGGERS], self.path)
                _length(file[TRIGGERS])
                edges = file[TRIGGERS][:]
                self.triggers.append(edges["t"], edges["id"], edges["p"] > 0)
        except DAMAGE:
            self.losses.add("bad_record")


def library() -> Any:
    """Return h5py.

    Raises:
        MissingExtraError: It is not installed.
    """
    h5py = import_extra("h5py", "HDF5", "formats")
    with suppress(ImportError):
        import hdf5plugin  # noqa: F401  (registers blosc, zstd, bitshuffle ...)
    return h5py


def _opened(path: Path) -> Any:
    h5py = library()
    try:
        # The cache holds the largest chunk that is read: else it is unpacked for each slice.
        return h5py.File(path, "r", rdcc_nbytes=PIECE_LIMIT_BYTES // 2)
    except OSError as error:
        reason = f"is no readable HDF5 file ({error}); a truncated one cannot be mended"
        raise FormatError(f"{str(path)!r} {reason}") from error


def _slice(path: Path, dataset: Any, rows: slice) -> np.ndarray[Any, Any]:
    """Return rows of a table, or of a column whatever axes of length 1 it has."""
    _, width, across = columns.laid_out(dataset.shape)
    try:
        read = np.asarray(dataset[:, rows].T if across else dataset[rows])
        return read if width else read.reshape(-1)
    except DAMAGE as error:
        settings = dataset.id.get_create_plist()
        filters = [settings.get_filter(index)[0] for index in range(settings.get_nfilters())]
        if ECF_FILTER not in filters:
            raise
        raise MissingExtraError(
            f"{str(path)!r} is compressed by Prophesee's ECF filter, which h5py cannot undo: read "
            "it with the package evlib (pip install evlib), or export it as RAW or without ECF"
        ) from error


def _streams(file: Any, path: Path) -> list[_Stream]:
    """Return every stream of events, in the order of their names; links are not followed."""
    groups, looked_at = [file], 0
    found: list[_Stream] = []
    links: list[str] = []
    while groups and looked_at < OBJECTS_LIMIT:
        group = groups.pop()
        names = sorted(group.keys())
        looked_at += len(names)
        linked = [name for name in names if hasattr(group.get(name, getlink=True), "path")]
        links += linked
        items = {name: group[name] for name in names if name not in linked}
        groups += [item for item in items.values() if hasattr(item, "keys")]
        found += _streams_of(
            group, {n: item for n, item in items.items() if hasattr(item, "dtype")}
        )
    if not found:
        more = f"; {', '.join(links)} is a link, which is not followed: copy it" if links else ""
        raise FormatError(
            f"{str(path)!r} holds no events: neither a group with columns named x, y, p and t, nor "
            f"a table of such fields or of four numbers{more}"
        )
    return sorted(found, key=lambda stream: stream.places)


def _streams_of(group: Any, tables: dict[str, Any]) -> Iterator[_Stream]:
    flat = {name: item for name, item in tables.items() if len(item.shape or ()) in (1, 2)}
    widths = {name: columns.laid_out(item.shape)[1] for name, item in flat.items()}
    rows = [n for n, item in flat.items() if not widths[n] and item.dtype.kind in "uifb"]
    if order := columns.order_named(rows):
        places = tuple(tables[rows[index]].name for index in order.place.values())
        place = {role: number for number, role in enumerate(order.place)}
        yield _Stream(group.name, places, Order(place, order.unit))
    for name, item in tables.items():
        if item.dtype.names and (fields := columns.order_named(item.dtype.names)):
            yield _Stream(group.name, (item.name,), fields)
        if (
            widths.get(name) in TABLE_WIDTHS
            and "event" in name.lower()
            and item.dtype.kind in "uif"
        ):
            yield _Stream(group.name, (item.name,))


def _require_plain(dataset: Any, path: Path) -> None:
    """Refuse what is no plain row or table of numbers in this file, or claims too much."""
    where, fields = f"{str(path)!r}: {dataset.name!r}", dataset.dtype.fields or {}
    types = [entry[0] for entry in fields.values()] or [dataset.dtype]
    if not all(kind.kind in "uifb" and not kind.shape for kind in types):
        raise FormatError(f"{where} is {dataset.dtype}; rows of numbers are needed")
    if dataset.external or dataset.is_virtual:
        raise FormatError(f"{where} lies in other files, which are not read; copy it into this one")
    row_bytes = dataset.dtype.itemsize
    if row_bytes > ROW_LIMIT_BYTES:
        raise FormatError(f"{where} has rows of {row_bytes} bytes (valid: to {ROW_LIMIT_BYTES})")
    if dataset.chunks is not None:
        refuse_piece(f"{where}: a chunk", 2 * int(np.prod(dataset.chunks)) * row_bytes)


def _length(dataset: Any) -> int:
    """Return a dataset's rows; refuse more than its bytes can hold: reading it would not end."""
    claimed = dataset.size * dataset.dtype.itemsize
    if claimed > COMPRESSION_LIMIT * max(dataset.id.get_storage_size(), LEAST_STORED_BYTES):
        raise ValueError(f"{dataset.name} claims {claimed} bytes")
    return columns.laid_out(dataset.shape)[0]


def _beside(file: Any, group: str, names: tuple[str, ...]) -> Any:
    """Return the first data set of some names in a group or one that holds it, or None."""
    levels = group.rstrip("/").split("/")
    depths = range(len(levels), 0, -1)
    places = ("/".join([*levels[:depth], name]) for depth in depths for name in names)
    found = (file[place] for place in places if place in file)
    return next((item for item in found if not getattr(item, "external", None)), None)


def _offset_us(file: Any, group: str) -> int | None:
    """Return what is added to the times, us; None where it cannot be meant."""
    offset = _beside(file, group, ("t_offset",))
    if offset is None:
        return 0
    single = getattr(offset, "shape", None) in ((), (1,)) and offset.dtype.kind in "ui"
    value = int(np.ravel(offset[()])[0]) if single else TIME_LIMIT_US + 1
    return value if abs(value) <= TIME_LIMIT_US else None


def _unit(attributes: list[dict[str, Any]]) -> str | None:
    """Return the unit of time that an attribute tells, or None."""
    texts = (str(told.get("units", told.get("unit"))).strip("[']") for told in attributes)
    return next(filter(None, (columns.role_of(f"t [{text}]")[1] for text in texts)), None)


def _size(file: Any, attributes: list[dict[str, Any]], group: str) -> tuple[int, int] | None:
    """Return the size that an attribute or a data set beside the events tells, or None."""
    for told in attributes:
        width, _, height = str(told.get("geometry")).partition("x")
        if width.isdigit() and height.isdigit():
            return int(width), int(height)
        if "width" in told and "height" in told:
            return int(told["width"]), int(told["height"])
        if "sensor_resolution" in told:
            height, width = told["sensor_resolution"][:2]
            return int(width), int(height)
    resolution = _beside(file, group, ("calib/resolution", "resolution"))
    if resolution is not None and getattr(resolution, "shape", None) == (2,):
        return int(resolution[0]), int(resolution[1])
    return None


def read_attributes(path: Path, objects: Sequence[str]) -> list[dict[str, Any]]:
    """Return the attributes of each object that tell a size or a unit.

    They are read in a process that can be ended: damaged ones make the library search for ever.
    """
    command = [sys.executable, "-P", "-c", _ATTRIBUTES, str(path), *objects]
    try:
        done = subprocess.run(
            command, capture_output=True, stdin=subprocess.DEVNULL, timeout=TIME_LIMIT_S
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"no end of its attributes within {TIME_LIMIT_S:g} s") from None
    if done.returncode:
        told = done.stderr.decode(errors="replace").strip().splitlines() or ["the reader died"]
        raise ValueError(f"its attributes cannot be read: {told[-1]}")
    return json.loads(done.stdout)
