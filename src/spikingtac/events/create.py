"""Create event files: the ending picks the format."""

import errno
import os
import shutil
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac import plugins
from spikingtac.atomic_files import WholeFile
from spikingtac.errors import ConfigError, named
from spikingtac.events.evt.raw_writer import RawWriter
from spikingtac.events.formats.aedat4 import EVENT, PACKET_HEAD, SIGNATURE
from spikingtac.events.formats.array_file import ColumnFile
from spikingtac.events.formats.codec import Blocks, EventWriter, OneFileWriter, Triggers
from spikingtac.events.formats.hdf5 import TRIGGERS, library
from spikingtac.types import EventPacket

TYPES = {"t": np.dtype("<i8"), "x": np.dtype("<u2"), "y": np.dtype("<u2"), "p": np.dtype("?")}

# Types of an event and of a trigger edge in HDF5, as OpenEB aligns them.
HDF5_EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")], align=True)
HDF5_EDGE = np.dtype([("p", "<i2"), ("t", "<i8"), ("id", "<i2")], align=True)
STORED_ROWS = 1 << 14  # Rows that are compressed together.

# Room on the disk below which nothing more is written, bytes: the library ends the process where it
# cannot write while it closes a file.
LEAST_ROOM_BYTES = 1 << 22

STREAM = 0
PACKET_EVENTS = 4_096  # Events in a packet; readers load a packet at once.

# FlatBuffers up to their vector: place of the table, type, field table and table. The IOHeader has
# compression and table position at their defaults; structures are aligned to eight bytes.
_IO_HEADER = struct.pack("<I4sHHHHH2xiI", 20, b"IOHE", 10, 8, 0, 0, 4, 12, 4)
_EVENT_PACKET = struct.pack("<I4sHHH2xiI8x", 16, b"EVTS", 6, 8, 4, 8, 12)

_NODE = (
    '<dv version="2.0"><node name="outInfo" path="/mainloop/Recorder/outInfo/">'
    '<node name="0" path="/mainloop/Recorder/outInfo/0/">'
    '<attr key="compression" type="string">NONE</attr>'
    '<attr key="originalModuleName" type="string">spikingtac</attr>'
    '<attr key="originalOutputName" type="string">events</attr>'
    '<attr key="typeDescription" type="string">Array of events (polarity ON/OFF).</attr>'
    '<attr key="typeIdentifier" type="string">EVTS</attr>'
    '<node name="info" path="/mainloop/Recorder/outInfo/0/info/">'
    '<attr key="sizeX" type="int">{0}</attr><attr key="sizeY" type="int">{1}</attr>'
    '<attr key="source" type="string">spikingtac</attr></node></node></node></dv>'
)


class NpzWriter(ColumnFile, EventWriter):
    """Writes event ``.npz`` files packet by packet."""

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        super().__init__(path)
        self.size = size
        self.append({name: np.empty(0, dtype) for name, dtype in TYPES.items()})
        self.set("size", np.array(size, np.int64))

    def _add(self, packet: EventPacket) -> None:
        self.append({name: getattr(packet, name) for name in TYPES})

    def add_triggers(self, triggers: Triggers) -> None:
        """Append trigger edges; the file has their columns only where there are any."""
        self.append(triggers.columns())


class TextWriter(OneFileWriter):
    """Writes event tables: ``# size W H``, the header ``t,x,y,p``, times in us."""

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        super().__init__(path, size, f"# size {size[0]} {size[1]}\nt,x,y,p\n".encode())

    def _add(self, packet: EventPacket) -> None:
        table = np.column_stack((packet.t, packet.x, packet.y, packet.p.astype(np.int64)))
        np.savetxt(self._file, table, "%d", ",")


class Aedat4Writer(OneFileWriter):
    """Writes AEDAT4 files packet by packet, uncompressed."""

    side_limit_px = 1 << 15  # An address has sixteen bits, one of them for the sign.

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        self._blocks = Blocks(EVENT, PACKET_EVENTS)
        info = _NODE.format(*size).encode("ascii")
        super().__init__(path, size, SIGNATURE + _flatbuffer(_IO_HEADER, len(info), info + b"\0"))

    def _add(self, packet: EventPacket) -> None:
        self._put(self._blocks.add(t=packet.t, x=packet.x, y=packet.y, on=packet.p))

    def _finish(self) -> None:
        self._put(self._blocks.rest)

    def _put(self, events: NDArray[Any]) -> None:
        for first in range(0, len(events), PACKET_EVENTS):
            packet = events[first : first + PACKET_EVENTS]
            data = _flatbuffer(_EVENT_PACKET, len(packet), packet.tobytes())
            self._file.write(PACKET_HEAD.pack(STREAM, len(data)) + data)


def _flatbuffer(head: bytes, count: int, content: bytes) -> bytes:
    """Return a size-prefixed FlatBuffer with one vector, or one text, of ``count`` elements."""
    body = head + struct.pack("<I", count) + content
    body += bytes(-len(body) % 4)
    return struct.pack("<I", len(body)) + body


class Hdf5Writer(EventWriter):
    """Writes HDF5 files packet by packet, with OpenEB's data sets, shuffled and deflated.

    Source: OpenEB, ``hdf5_event_file_writer.cpp`` (Apache-2.0). Its own reader takes events under
    its ECF compression alone.

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
        for name, kind in (("CD/events", HDF5_EVENT), (TRIGGERS, HDF5_EDGE)):
            self._file.create_dataset(
                name, (0,), kind, maxshape=(None,), chunks=(STORED_ROWS,), shuffle=True,
                compression="gzip", compression_opts=1, track_times=False,
            )  # fmt: skip
        self._events = Blocks(HDF5_EVENT, STORED_ROWS)
        self._edges = Blocks(HDF5_EDGE, STORED_ROWS)

    def _add(self, packet: EventPacket) -> None:
        self._store("CD/events", self._events.add(x=packet.x, y=packet.y, p=packet.p, t=packet.t))

    def add_triggers(self, triggers: Triggers) -> None:
        """Append trigger edges."""
        rows = self._edges.add(p=triggers.edge, t=triggers.t_us, id=triggers.channel)
        self._store(TRIGGERS, rows)

    def _store(self, name: str, rows: NDArray[Any]) -> None:
        if len(rows):
            stored = self._file[name]
            if shutil.disk_usage(self._target.partial.parent).free < rows.nbytes + LEAST_ROOM_BYTES:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._target.path))
            length = len(stored)
            stored.resize((length + len(rows),))
            stored[length:] = rows

    def close(self) -> None:
        """Complete the file; further calls do nothing."""
        if self._file:
            self._store("CD/events", self._events.rest)
            self._store(TRIGGERS, self._edges.rest)
            self._file.close()
            self._target.commit()

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._file.close()
        self._target.abandon()


# Ending -> what writes it.
_WRITERS: dict[str, Callable[..., EventWriter]] = {
    "raw": RawWriter, "npz": NpzWriter, "csv": TextWriter, "txt": TextWriter,
    "h5": Hdf5Writer, "hdf5": Hdf5Writer, "aedat4": Aedat4Writer,
}  # fmt: skip


def writer_of(ending: str, encoding: str | None = None) -> Callable[..., EventWriter]:
    """Return what writes files of an ending, with or without its point.

    Raises:
        ConfigError: The ending is unknown, or has no such encoding.
    """
    plain = ending.lower().removeprefix(".")
    if encoding is not None and plain != "raw":
        raise ConfigError(
            f"encoding {encoding!r} is for .raw files, not for .{plain}; leave it out"
        )
    writer = named(plugins.WithPlugins(_WRITERS, plugins.WRITERS), plain, "ending to write")
    return writer if encoding is None else partial(writer, encoding=encoding)


def create_events(
    path: str | Path, size: tuple[int, int], *, encoding: str | None = None
) -> EventWriter:
    """Open a file for writing events, packet by packet, at constant memory.

    The same events give the same bytes on every machine and day, wherever the packets are cut.

    Args:
        path: File to write; its ending picks the format.
        size: ``(width, height)`` of the sensor, px.
        encoding: For ``.raw``: ``evt3`` (the default), ``evt21`` or ``evt2``.

    Raises:
        ConfigError: The ending or the encoding is unknown, or the size no pair of whole numbers
            from 1 on.
        FormatError: The sensor does not fit into the format.
        MissingExtraError: The format needs a library of the extra ``[formats]``.
    """
    if any(side < 1 or side % 1 for side in size):
        raise ConfigError(f"size is {size}, it must be (width, height) in whole px from 1 on")
    return writer_of(Path(path).suffix, encoding)(path, size)
