"""Write HDF5 files of events as Metavision does: ``CD/events``, shuffled and deflated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.codec import EventWriter
from spikingtac.events.formats.hdf5 import library
from spikingtac.types import EventPacket

STORED_ROWS = 1 << 14
"""Rows that are compressed together."""

EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
"""Metavision's event, in Metavision's order."""


class Hdf5Writer(EventWriter):
    """Writes Metavision-style files (``CD/events``, shuffled and deflated) packet by packet.

    Raises:
        MissingExtraError: The library h5py is not installed.
    """

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        h5py = library()
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
