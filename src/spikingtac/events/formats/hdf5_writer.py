"""Write HDF5 files of events as Metavision does: ``CD/events``, shuffled and deflated."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import WholeFile
from spikingtac.events.formats.codec import EventWriter
from spikingtac.events.tables.hdf5 import library
from spikingtac.types import EventPacket

T = TypeVar("T")

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
        self._target = WholeFile(path)
        self._disk = _Disk(self._target.open("w+b"))
        self._file: Any = h5py.File(self._disk, "w", libver=("v108", "v108"))
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
        """Append a packet.

        Raises:
            OSError: The disk is full, or fails.
        """
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
            try:
                self._append(self._pending)
                self._file.close()
                self._disk.finish()
            except BaseException:
                self.abandon()
                raise
            self._target.commit()

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._file.close()
        with suppress(OSError):
            self._disk.finish()
        self._target.abandon()

    def _append(self, rows: NDArray[Any]) -> None:
        if len(rows):
            length = len(self._events)
            self._events.resize((length + len(rows),))
            self._events[length:] = rows
            self._disk.require_sound()


class _Disk:
    """The file below HDF5; from its first error on it takes everything and keeps nothing.

    The library ends the process where it cannot write while it closes a file. So it never hears of
    an error; the writer asks for it and raises it.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._error: OSError | None = None

    def require_sound(self) -> None:
        """Raise the first error.

        Raises:
            OSError: As the disk said it.
        """
        if self._error is not None:
            raise self._error

    def finish(self) -> None:
        """Close the file.

        Raises:
            OSError: As the disk said it, now or before.
        """
        try:
            self._file.close()
        except OSError as error:
            self._error = self._error or error
        self.require_sound()

    def write(self, data: bytes) -> int:
        """Write at the present place."""
        self._tried(lambda: self._file.write(data))
        return len(data)

    def read(self, length: int) -> bytes:
        """Read from the present place (h5py looks for it, and calls :meth:`readinto`)."""
        return self._tried(lambda: self._file.read(length)) or b""

    def readinto(self, buffer: memoryview) -> int:
        """Read from the present place; zeros where that fails."""
        buffer[:] = bytes(len(buffer))
        found = self._tried(lambda: self._file.read(len(buffer))) or b""
        buffer[: len(found)] = found
        return len(buffer)

    def seek(self, place: int, whence: int = 0) -> int:
        """Move the present place."""
        return self._tried(lambda: self._file.seek(place, whence)) or 0

    def tell(self) -> int:
        """Return the present place."""
        return self._tried(self._file.tell) or 0

    def truncate(self, length: int) -> int:
        """Set the file's length."""
        self._tried(lambda: self._file.truncate(length))
        return length

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._tried(self._file.flush)

    def _tried(self, work: Callable[[], T]) -> T | None:
        if self._error is not None:
            return None
        try:
            return work()
        except OSError as error:
            self._error = error
            return None
