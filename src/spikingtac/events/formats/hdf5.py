"""HDF5 files of events: Metavision's ``CD/events``, DSEC's columns, and plain columns.

A truncated HDF5 file cannot be read at all: record RAW, archive HDF5.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import FormatError, MissingExtraError
from spikingtac.events.formats.checks.hdf5_attributes import read_attributes
from spikingtac.events.formats.checks.limits import piece_limit_bytes, refuse_piece
from spikingtac.events.formats.checks.time_course import TIME_LIMIT_US
from spikingtac.events.formats.checks.time_unit import US_PER_S, in_seconds
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows

CHUNK_ROWS = 1 << 17
LEAST_STORED_BYTES = 1 << 14
"""Stored bytes below which no claim is weighed against them."""

ROW_LIMIT_BYTES = 1 << 10
"""Longest row of a table that is read; an event takes 16."""

LINK_DEPTH = 8
"""Links to links that are followed."""

COMPRESSION_LIMIT = 2_000
"""Most that compression is believed to gain; deflate cannot exceed 1,032."""

DAMAGE = (
    OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError,
    IndexError, AttributeError,
)  # fmt: skip
"""What h5py raises on damaged files."""

ECF_FILTER = 0x8ECF
"""Prophesee's compression, of which no wheel exists."""

_TABLES = ("CD/events", "events", "prophesee/events")
_GROUPS = ("events", "events/left", "CD", "/", "davis/left/events")
_SYNONYMS = {
    "x": ("x", "xs"),
    "y": ("y", "ys"),
    "p": ("p", "ps", "pol", "polarity", "on"),
    "t": ("t", "ts", "timestamp", "timestamps", "time"),
}


class Hdf5Source(FileSource):
    """Events of an HDF5 file; times are us, or seconds where they are no whole numbers.

    Raises:
        MissingExtraError: The library h5py is not installed.
        FormatError: The file cannot be read, holds no events in a known place, leads to other files
            or claims too much.
    """

    format = "HDF5"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with _opened(path) as file:
            try:
                self._layout = _layout_of(file, path)
                self._named_size = _size_of(file, path)
            except DAMAGE as error:
                raise FormatError(f"{str(path)!r} is damaged: {error}") from error
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        return self._named_size or self._size_from_events()

    def _columns(self) -> Iterator[Rows]:
        with _opened(self.path) as file:
            try:
                lengths = {
                    _length(file[place.partition("?")[0]]) for place in self._layout.values()
                }
                offset = _offset_of(file, self.path)
            except DAMAGE:
                self.losses.add("bad_record")
                return
            total = min(lengths)
            self.losses.add("truncated", int(total < max(lengths)))
            if offset is None:
                self.losses.add("bad_record")
            seconds: bool | None = None
            for first in range(0, total, CHUNK_ROWS):
                rows = slice(first, min(first + CHUNK_ROWS, total))
                try:
                    x, y, p, t = self._read(file, rows)
                except DAMAGE as error:
                    self._explain(file, error)
                    self.losses.add("bad_record")
                    continue
                self.progress = rows.stop / total
                seconds = in_seconds(t) if seconds is None else seconds
                t = _microseconds(t, seconds)
                yield x, y, p, _shifted(t, offset or 0)

    def _read(self, file: Any, rows: slice) -> Rows:
        places = [self._layout[name] for name in ("x", "y", "p", "t")]
        if "?" in places[0]:
            table = file[places[0].partition("?")[0]][rows]
            x, y, p, t = (table[place.partition("?")[2]] for place in places)
        else:
            x, y, p, t = (file[place][rows] for place in places)
        return np.asarray(x), np.asarray(y), np.asarray(p), np.asarray(t)

    def _explain(self, file: Any, error: Exception) -> None:
        """Raise where the filter is missing, not the data damaged."""
        place = self._layout["t"].partition("?")[0]
        settings = file[place].id.get_create_plist()
        filters = [settings.get_filter(index)[0] for index in range(settings.get_nfilters())]
        if ECF_FILTER in filters:
            raise MissingExtraError(
                f"{str(self.path)!r} is compressed by Prophesee's ECF filter, which no Python "
                "package brings; convert the recording to RAW with metavision_hdf5_to_raw "
                "or to HDF5 without ECF"
            ) from error


def library() -> Any:
    """Return h5py.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("HDF5 files need: pip install 'spikingtac[formats]'") from error
    with suppress(ImportError):
        import hdf5plugin  # noqa: F401  (registers blosc, zstd, bitshuffle ...)
    return h5py


def _opened(path: Path) -> Any:
    h5py = library()
    try:
        # The cache holds the largest chunk that is read: else it is unpacked for each slice.
        return h5py.File(path, "r", rdcc_nbytes=piece_limit_bytes() // 2)
    except OSError as error:
        raise FormatError(
            f"{str(path)!r} is no readable HDF5 file ({error}); a truncated one cannot be mended"
        ) from error


def _layout_of(file: Any, path: Path) -> dict[str, str]:
    """Return where each column lies: ``dataset`` or ``dataset?field``."""
    for place in _TABLES:
        table = _found(file, place, path)
        names = getattr(getattr(table, "dtype", None), "names", None)
        if names and (found := _matched(names)):
            _require_columns(table, [table.dtype[field] for field in found.values()], path)
            return {name: f"{table.name}?{field}" for name, field in found.items()}
    for place in _GROUPS:
        group = _found(file, place, path)
        if hasattr(group, "keys") and (found := _matched(list(group.keys()))):
            columns = {name: _found(group, field, path) for name, field in found.items()}
            for column in columns.values():
                _require_columns(column, [getattr(column, "dtype", None)], path)
            return {name: column.name for name, column in columns.items()}
    raise FormatError(
        f"{str(path)!r} holds no events where they are looked for: a table in "
        f"{', '.join(_TABLES)}, or the columns x, y, p and t in {', '.join(_GROUPS)}"
    )


def _found(group: Any, place: str, path: Path, depth: int = 0) -> Any:
    """Return what lies at a place of this very file, or None.

    Raises:
        FormatError: The place leads to another file.
    """
    for name in place.split("/"):
        if not name or not hasattr(group, "keys"):
            group = group if not name else None
            continue
        link = group.get(name, getlink=True)
        target = getattr(link, "path", None)
        if hasattr(link, "filename"):
            raise FormatError(
                f"{str(path)!r}: {name!r} is a link into another file, which is not followed; "
                "open that file, or copy the events into this one"
            )
        if target is not None and depth < LINK_DEPTH:
            start = group.file if target.startswith("/") else group
            group = _found(start, target, path, depth + 1)
        else:
            group = group[name] if target is None and name in group else None
    return group


def _require_columns(dataset: Any, types: list[Any], path: Path) -> None:
    """Refuse what is no plain row of numbers in this file, or claims too much.

    Raises:
        FormatError: The dataset is odd, lies in other files, or its chunks are beyond the limit.
    """
    where = f"{str(path)!r}: {getattr(dataset, 'name', 'a column')!r}"
    numbers = all(kind is not None and kind.kind in "uifb" and not kind.shape for kind in types)
    if len(getattr(dataset, "shape", None) or ()) != 1 or not numbers:
        found = getattr(dataset, "dtype", "no data set"), getattr(dataset, "shape", "")
        raise FormatError(
            f"{where} is {found[0]} of shape {found[1]}; one row of numbers is needed"
        )
    if dataset.external or dataset.is_virtual:
        raise FormatError(f"{where} lies in other files, which are not read; copy it into this one")
    row_bytes = dataset.dtype.itemsize
    if row_bytes > ROW_LIMIT_BYTES:
        raise FormatError(f"{where} has rows of {row_bytes} bytes (valid: to {ROW_LIMIT_BYTES})")
    if dataset.chunks is not None:
        refuse_piece(f"{where}: a chunk", 2 * dataset.chunks[0] * row_bytes)


def _length(dataset: Any) -> int:
    """Return a dataset's rows.

    Raises:
        ValueError: It claims more than its bytes can hold, and reading it would not end.
    """
    claimed = len(dataset) * dataset.dtype.itemsize
    if claimed > COMPRESSION_LIMIT * max(dataset.id.get_storage_size(), LEAST_STORED_BYTES):
        raise ValueError(f"{dataset.name} claims {claimed} bytes")
    return len(dataset)


def _offset_of(file: Any, path: Path) -> int | None:
    """Return what is added to the times, us; None where it cannot be meant."""
    offset = _found(file, "t_offset", path)
    if offset is None:
        return 0
    if (
        getattr(offset, "shape", None) not in ((), (1,))
        or offset.dtype.kind not in "ui"
        or offset.external
    ):
        return None
    value = int(np.ravel(offset[()])[0])
    return value if abs(value) <= TIME_LIMIT_US else None


def _matched(names: Any) -> dict[str, str] | None:
    found = {
        column: next((name for name in synonyms if name in names), "")
        for column, synonyms in _SYNONYMS.items()
    }
    return found if all(found.values()) else None


def _size_of(file: Any, path: Path) -> tuple[int, int] | None:
    """Return the size that an attribute tells, or None.

    Raises:
        ValueError: The attributes are damaged, or tell no size.
    """
    objects = [_found(file, place, path) for place in ("/", "CD", "CD/events", "events")]
    names = [found.name for found in objects if hasattr(found, "attrs")]
    for attributes in read_attributes(path, names):
        if "geometry" in attributes:
            width, _, height = str(attributes["geometry"]).partition("x")
            if width.isdigit() and height.isdigit():
                return int(width), int(height)
        if "width" in attributes and "height" in attributes:
            return int(attributes["width"]), int(attributes["height"])
        if "sensor_resolution" in attributes:
            height, width = (int(value) for value in attributes["sensor_resolution"][:2])
            return width, height
    return None


def _shifted(t: NDArray[Any], offset: int) -> NDArray[Any]:
    if not offset:
        return t
    return (t.astype(np.int64) if t.dtype.kind in "iu" else t) + offset


def _microseconds(t: NDArray[Any], seconds: bool) -> NDArray[Any]:
    """Return whole numbers as they are, and seconds as microseconds."""
    if t.dtype.kind != "f":
        return t
    return np.nan_to_num(t.astype(np.float64)) * (US_PER_S if seconds else 1)
