"""Write HDF5 files of events in OpenEB's layout, shuffled and deflated.

Source: OpenEB, ``hdf5_event_file_writer.cpp`` (Apache-2.0): ``CD`` and ``EXT_TRIGGER`` hold
``events`` and ``indexes``. OpenEB's own reader takes events under its ECF compression alone.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import WholeFile
from spikingtac.errors import FormatError
from spikingtac.events.formats.codec import EventWriter, Triggers
from spikingtac.events.tables.hdf5 import library
from spikingtac.types import EventPacket

T = TypeVar("T")

STORED_ROWS = 1 << 14  # Rows that are compressed together.

INDEX_PERIOD_US = 2_000  # Time that one entry of the indexes stands for.

# Longest pause between two events that is indexed: a day.
LONGEST_PAUSE_PERIODS = 86_400_000_000 // INDEX_PERIOD_US


def _aligned(**kinds: str) -> np.dtype[Any]:
    return np.dtype(list(kinds.items()), align=True)


EVENT = _aligned(x="<u2", y="<u2", p="<i2", t="<i8")
EDGE = _aligned(p="<i2", t="<i8", id="<i2")
INDEX = _aligned(id="<u8", ts="<i8")


class Hdf5Writer(EventWriter):
    """Writes files in OpenEB's layout packet by packet.

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
        self._file.attrs["version"] = "1.0"
        self._events = _Indexed(self._file, "CD", EVENT)
        self._edges = _Indexed(self._file, "EXT_TRIGGER", EDGE)

    def write(self, packet: EventPacket) -> None:
        """Append a packet.

        Raises:
            FormatError: A pause between two events is longer than a day.
            OSError: The disk is full, or fails.
        """
        self._events.append(x=packet.x, y=packet.y, p=packet.p, t=packet.t)
        self._disk.require_sound()

    def add_triggers(self, triggers: Triggers) -> None:
        """Append trigger edges."""
        self._edges.append(p=triggers.edge, t=triggers.t_us, id=triggers.channel)

    def close(self) -> None:
        """Complete the file; further calls do nothing."""
        if self._file:
            try:
                self._events.finish()
                self._edges.finish()
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


class _Rows:
    """A data set that grows by whole chunks, so that its bytes do not depend on the packets."""

    def __init__(self, group: Any, name: str, kind: np.dtype[Any]) -> None:
        self._set = group.create_dataset(
            name, (0,), kind, maxshape=(None,), chunks=(STORED_ROWS,), shuffle=True,
            compression="gzip", compression_opts=1, track_times=False,
        )  # fmt: skip
        self._pending = np.zeros(0, kind)

    def append(self, **columns: NDArray[Any]) -> None:
        """Append rows, given as columns."""
        held = len(self._pending)
        rows = np.zeros(held + len(next(iter(columns.values()))), self._pending.dtype)
        rows[:held] = self._pending
        for name, column in columns.items():
            rows[name][held:] = column
        whole = len(rows) // STORED_ROWS * STORED_ROWS
        self._store(rows[:whole])
        self._pending = rows[whole:]

    def finish(self) -> None:
        """Store the rows that still wait."""
        self._store(self._pending)

    def _store(self, rows: NDArray[Any]) -> None:
        if len(rows):
            length = len(self._set)
            self._set.resize((length + len(rows),))
            self._set[length:] = rows


class _Indexed:
    """``events`` with their ``indexes``: where each period of 2 ms begins.

    An entry tells the first event of the latest period before its own that has any, and its time
    since the first one; one more stands at the end.
    """

    def __init__(self, file: Any, name: str, kind: np.dtype[Any]) -> None:
        group = file.create_group(name)
        self._events, self._indexes = _Rows(group, "events", kind), _Rows(group, "indexes", INDEX)
        self._group, self._first_us = group, 0
        self._period, self._begin, self._count = -1, (0, -1), 0

    def append(self, t: NDArray[np.int64], **columns: NDArray[Any]) -> None:
        """Append events and the entries of the periods that they begin."""
        if not len(t):
            return
        if not self._count:
            self._first_us = int(t[0])
            self._group["indexes"].attrs["offset"] = str(-self._first_us)
        since = t - self._first_us
        periods = since // INDEX_PERIOD_US
        new = np.flatnonzero(np.diff(periods, prepend=self._period) > 0)
        steps = np.diff(periods[new], prepend=self._period)
        if len(steps) and int(steps.max()) > LONGEST_PAUSE_PERIODS:
            raise FormatError("a pause of more than a day cannot be indexed; split the recording")
        numbers = np.concatenate(([self._begin[0]], new + self._count))
        times = np.concatenate(([self._begin[1]], since[new]))
        self._indexes.append(id=np.repeat(numbers[:-1], steps), ts=np.repeat(times[:-1], steps))
        self._period, self._begin = int(periods[-1]), (int(numbers[-1]), int(times[-1]))
        self._count += len(t)
        self._events.append(t=t, **columns)

    def finish(self) -> None:
        """Store what still waits, and the last entry."""
        if self._count:
            number, time_us = (np.array([value]) for value in self._begin)
            self._indexes.append(id=number, ts=time_us)
        self._events.finish()
        self._indexes.finish()


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
