"""HDF5 files of events: OpenEB, v2e, MVSEC, M3ED, DSEC, and any group or table of x, y, p and t.

A truncated HDF5 file cannot be read at all: record RAW, archive HDF5. Files are written with
OpenEB's data sets, shuffled and deflated. Source: OpenEB, ``hdf5_event_file_writer.cpp``
(Apache-2.0): ``CD/events`` and ``EXT_TRIGGER/events``. Its own reader takes events under its ECF
compression alone.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import WholeFile
from spikingtac.errors import FormatError, MissingExtraError, SpikingTacError
from spikingtac.events.formats.codec import Blocks, EventWriter, Triggers
from spikingtac.events.formats.columns import (
    CHUNK_ROWS,
    ROLES,
    Order,
    TableSource,
    order_of_values,
    rows_of,
)
from spikingtac.events.formats.file_source import ReadOptions, Rows, chosen_sensor
from spikingtac.events.formats.hdf5_layout import (
    find_streams,
    offset_of,
    require_plain,
    rows_in,
    size_of,
)
from spikingtac.events.formats.pieces import PIECE_LIMIT_BYTES
from spikingtac.types import EventPacket

# What h5py raises on damaged files.
DAMAGE = (
    OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError,
    IndexError, AttributeError,
)  # fmt: skip

ECF_FILTER = 0x8ECF  # Prophesee's compression, which hdf5plugin does not bring.

TRIGGERS = "EXT_TRIGGER/events"

# Types of an event and of a trigger edge, as OpenEB aligns them.
EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")], align=True)
EDGE = np.dtype([("p", "<i2"), ("t", "<i8"), ("id", "<i2")], align=True)
STORED_ROWS = 1 << 14  # Rows that are compressed together.

# Room on the disk below which nothing more is written, bytes: the library ends the process where it
# cannot write while it closes a file.
LEAST_ROOM_BYTES = 1 << 22


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
        places, order = self._stream.places, self._order
        if order is None:
            x, y, p, t = (self._slice(self.path, file[place], rows) for place in places)
        else:
            table = self._slice(self.path, file[places[0]], rows)
            x, y, p, t = rows_of(table, order.place)
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
        return h5py.File(path, "r", rdcc_nbytes=PIECE_LIMIT_BYTES // 2)
    except OSError as error:
        raise FormatError(
            f"{str(path)!r} is no readable HDF5 file ({error}); a truncated one cannot be mended"
        ) from error


class Hdf5Writer(EventWriter):
    """Writes HDF5 files packet by packet.

    Raises:
        MissingExtraError: The library h5py is not installed.
    """

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        h5py = library()
        self.size = size
        self._target = WholeFile(path)
        self._file: Any = h5py.File(self._target.partial, "w", libver=("v108", "v108"))
        self._file.attrs["geometry"] = f"{size[0]}x{size[1]}"
        self._file.attrs["version"] = "1.0"
        self._sets = [self._made("CD/events", EVENT), self._made(TRIGGERS, EDGE)]

    def _made(self, name: str, kind: np.dtype[Any]) -> tuple[Any, Blocks]:
        made = self._file.create_dataset(
            name, (0,), kind, maxshape=(None,), chunks=(STORED_ROWS,), shuffle=True,
            compression="gzip", compression_opts=1, track_times=False,
        )  # fmt: skip
        return made, Blocks(kind, STORED_ROWS)

    def write(self, packet: EventPacket) -> None:
        """Append a packet.

        Raises:
            OSError: The disk is full.
        """
        events, blocks = self._sets[0]
        self._store(events, blocks.add(x=packet.x, y=packet.y, p=packet.p, t=packet.t))

    def add_triggers(self, triggers: Triggers) -> None:
        """Append trigger edges."""
        edges, blocks = self._sets[1]
        self._store(edges, blocks.add(p=triggers.edge, t=triggers.t_us, id=triggers.channel))

    def _store(self, stored: Any, rows: NDArray[Any]) -> None:
        if len(rows):
            room = shutil.disk_usage(self._target.partial.parent).free
            if room < rows.nbytes + LEAST_ROOM_BYTES:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._target.path))
            length = len(stored)
            stored.resize((length + len(rows),))
            stored[length:] = rows

    def close(self) -> None:
        """Complete the file; further calls do nothing."""
        if self._file:
            try:
                for stored, blocks in self._sets:
                    self._store(stored, blocks.rest)
                self._file.close()
            except BaseException:
                self.abandon()
                raise
            self._target.commit()

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._file.close()
        self._target.abandon()
