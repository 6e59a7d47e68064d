"""HDF5 files of events: OpenEB, v2e, MVSEC, M3ED, DSEC, and any group or table of x, y, p and t.

A truncated HDF5 file cannot be read at all: record RAW, archive HDF5.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import FormatError, MissingExtraError, SpikingTacError
from spikingtac.events.formats.file_source import ReadOptions, Rows, chosen_sensor
from spikingtac.events.formats.limits import piece_limit_bytes
from spikingtac.events.tables.columns import ROLES, Order, order_of_values
from spikingtac.events.tables.hdf5_layout import (
    find_streams,
    offset_of,
    require_plain,
    rows_in,
    size_of,
)
from spikingtac.events.tables.table_source import CHUNK_ROWS, TableSource

# What h5py raises on damaged files.
DAMAGE = (
    OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError,
    IndexError, AttributeError,
)  # fmt: skip

ECF_FILTER = 0x8ECF  # Prophesee's compression, which hdf5plugin does not bring.

TRIGGERS = "EXT_TRIGGER/events"


class Hdf5Source(TableSource):
    """Events of one camera in an HDF5 file.

    Raises:
        MissingExtraError: The library h5py is not installed, or the compression is Prophesee's ECF.
        FormatError: The file cannot be read, holds no events, leads to other files or claims too
            much; or it holds several cameras, and none was chosen.
    """

    format = "HDF5"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with _opened(path) as file:
            try:
                streams = find_streams(file, path)
                names = [stream.places[0].rpartition("/")[0] or "/" for stream in streams]
                self._stream = streams[chosen_sensor(names, options.sensor, path)]
                for place in {*self._stream.places}:
                    require_plain(file[place], path)
                self._unit = self._stream.unit
                self._order = self._stream.order or self._order_by_values(file, path)
                self._named_size = size_of(file, path, self._stream.group)
            except DAMAGE as error:
                if isinstance(error, SpikingTacError):
                    raise
                raise FormatError(f"{str(path)!r} is damaged: {error}") from error
        super().__init__(path, options)

    def _order_by_values(self, file: Any, path: Path) -> Order | None:
        """Return the order of a table of numbers; v2e's where the values leave it open."""
        if len(set(self._stream.places)) > 1:
            return None
        table = file[self._stream.places[0]]
        sample = self._slice(path, table, slice(0, CHUNK_ROWS))
        try:
            return order_of_values([sample], repr(str(path)))
        except FormatError:
            if table.dtype == np.uint32 and table.shape[1] == len(ROLES):
                return Order(place={"t": 0, "x": 1, "y": 2, "p": 3})
            raise

    def _rows(self) -> Iterator[Rows]:
        with _opened(self.path) as file:
            try:
                lengths = {rows_in(file[place]) for place in self._stream.places}
                offset = offset_of(file, self._stream.group)
            except DAMAGE:
                self.losses.add("bad_record")
                return
            self._take_triggers(file)
            total = min(lengths)
            self.losses.add("truncated", int(total < max(lengths)))
            self.losses.add("bad_record", int(offset is None))
            self._offset_us = offset or 0
            for first in range(0, total, CHUNK_ROWS):
                rows = slice(first, min(first + CHUNK_ROWS, total))
                self.progress = rows.stop / total
                try:
                    yield self._read(file, rows)
                except DAMAGE as error:
                    if isinstance(error, MissingExtraError):
                        raise
                    self.losses.add("bad_record")

    def _read(self, file: Any, rows: slice) -> Rows:
        places = self._stream.places
        if self._order is None:
            x, y, p, t = (self._slice(self.path, file[place], rows) for place in places)
            return x, y, p, t
        table = self._slice(self.path, file[places[0]], rows)
        names = table.dtype.names or ()
        x, y, p, t = (
            table[names[self._order.place[role]]] if names else table[:, self._order.place[role]]
            for role in ROLES
        )
        return x, y, p, t

    @staticmethod
    def _slice(path: Path, dataset: Any, rows: slice) -> np.ndarray[Any, Any]:
        try:
            return np.asarray(dataset[rows])
        except DAMAGE as error:
            settings = dataset.id.get_create_plist()
            filters = [settings.get_filter(index)[0] for index in range(settings.get_nfilters())]
            if ECF_FILTER not in filters:
                raise
            raise MissingExtraError(
                f"{str(path)!r} is compressed by Prophesee's ECF filter, which h5py cannot undo; "
                "the package evlib reads it (pip install evlib; evlib.load_events), or export the "
                "recording as RAW or without ECF"
            ) from error

    def _take_triggers(self, file: Any) -> None:
        try:
            if TRIGGERS not in file or not len(file[TRIGGERS]):
                return
            table = file[TRIGGERS]
            require_plain(table, self.path)
            rows_in(table)
            edges = table[:]
            self.triggers.append(edges["t"], edges["id"], edges["p"] > 0)
        except DAMAGE:
            self.losses.add("bad_record")


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
