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
from spikingtac.events.formats.codec import EventWriter
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.types import EventPacket

CHUNK_ROWS = 1 << 17
STORED_ROWS = 1 << 14
"""Rows that are compressed together."""

COMPRESSION_LIMIT = 2_000
"""Most that compression is believed to gain; deflate cannot exceed 1,032."""

DAMAGE = (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError)
"""What h5py raises on damaged files."""

ECF_FILTER = 0x8ECF
"""Prophesee's compression, of which no wheel exists."""

US_PER_S = 1_000_000
EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
"""Metavision's event, in Metavision's order."""

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
        FormatError: The file cannot be read, or holds no events in a known place.
    """

    format = "HDF5"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with _opened(path) as file:
            try:
                self._layout = _layout_of(file, path)
                self._named_size = _size_of(file)
            except DAMAGE as error:
                raise FormatError(f"{str(path)!r} is damaged: {error}") from error
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        return self._named_size or self._size_from_events()

    def _columns(self) -> Iterator[Rows]:
        with _opened(self.path) as file:
            try:
                total = min(
                    _length(file[place.partition("?")[0]]) for place in self._layout.values()
                )
                offset = int(file["t_offset"][()]) if "t_offset" in file else 0
            except DAMAGE:
                self.losses.add("bad_record")
                return
            for first in range(0, total, CHUNK_ROWS):
                rows = slice(first, min(first + CHUNK_ROWS, total))
                try:
                    x, y, p, t = self._read(file, rows)
                except DAMAGE as error:
                    self._explain(file, error)
                    self.losses.add("bad_record")
                    continue
                self.progress = rows.stop / total
                t = _microseconds(t)
                yield x, y, p, t + offset if offset else t

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


class Hdf5Writer(EventWriter):
    """Writes Metavision-style files (``CD/events``, shuffled and deflated) packet by packet.

    Raises:
        MissingExtraError: The library h5py is not installed.
    """

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        h5py = _library()
        self.size = size
        self._file: Any = h5py.File(path, "w", libver=("v108", "v108"))
        self._file.attrs["geometry"] = f"{size[0]}x{size[1]}"
        self._events: Any = self._file.create_dataset(
            "CD/events",
            (0,),
            EVENT,
            maxshape=(None,),
            chunks=(STORED_ROWS,),
            shuffle=True,
            compression="gzip",
            compression_opts=1,
            track_times=False,
        )
        self._pending = np.empty(0, EVENT)

    def write(self, packet: EventPacket) -> None:
        """Append a packet."""
        rows = np.empty(len(packet), EVENT)
        for name in ("x", "y", "p", "t"):
            rows[name] = getattr(packet, name)
        rows = np.concatenate((self._pending, rows))
        whole = len(rows) // STORED_ROWS * STORED_ROWS
        self._append(rows[:whole])
        self._pending = rows[whole:]

    def close(self) -> None:
        """Complete the file; further calls do nothing."""
        if self._file:
            self._append(self._pending)
            self._pending = self._pending[:0]
            self._file.close()

    def _append(self, rows: NDArray[Any]) -> None:
        if len(rows):
            length = len(self._events)
            self._events.resize((length + len(rows),))
            self._events[length:] = rows


def _library() -> Any:
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("HDF5 files need: pip install 'spikingtac[formats]'") from error
    with suppress(ImportError):
        import hdf5plugin  # noqa: F401  (registers blosc, zstd, bitshuffle ...)
    return h5py


def _opened(path: Path) -> Any:
    h5py = _library()
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise FormatError(
            f"{str(path)!r} is no readable HDF5 file ({error}); a truncated one cannot be mended"
        ) from error


def _layout_of(file: Any, path: Path) -> dict[str, str]:
    """Return where each column lies: ``dataset`` or ``dataset?field``."""
    for place in _TABLES:
        names = getattr(getattr(file.get(place), "dtype", None), "names", None)
        if names and (found := _matched(names)):
            return {name: f"{place}?{field}" for name, field in found.items()}
    for place in _GROUPS:
        group = file.get(place)
        if hasattr(group, "keys") and (found := _matched(list(group.keys()))):
            return {name: f"{place}/{field}" for name, field in found.items()}
    raise FormatError(
        f"{str(path)!r} holds no events where they are looked for: a table in "
        f"{', '.join(_TABLES)}, or the columns x, y, p and t in {', '.join(_GROUPS)}"
    )


def _length(dataset: Any) -> int:
    """Return a dataset's rows.

    Raises:
        ValueError: It claims more than its bytes can hold, and reading it would not end.
    """
    claimed = len(dataset) * dataset.dtype.itemsize
    if claimed > COMPRESSION_LIMIT * max(dataset.id.get_storage_size(), STORED_ROWS):
        raise ValueError(f"{dataset.name} claims {claimed} bytes")
    return len(dataset)


def _matched(names: Any) -> dict[str, str] | None:
    found = {
        column: next((name for name in synonyms if name in names), "")
        for column, synonyms in _SYNONYMS.items()
    }
    return found if all(found.values()) else None


def _size_of(file: Any) -> tuple[int, int] | None:
    for place in ("/", "CD", "CD/events", "events"):
        attributes = file[place].attrs if place in file else {}
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


def _microseconds(t: NDArray[Any]) -> NDArray[Any]:
    """Return whole numbers as they are, and seconds as microseconds."""
    return np.nan_to_num(t.astype(np.float64)) * US_PER_S if t.dtype.kind == "f" else t
