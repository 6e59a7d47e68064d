"""AEDAT4 files of iniVation's DV: read through the library aedat, written uncompressed.

Source: iniVation, "AEDAT 4.0" file format (public documentation): a line of text, an IOHeader and
packets, each a size-prefixed FlatBuffer. The few bytes of FlatBuffers that are needed are laid out
here by hand.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np

from spikingtac.errors import FormatError, MissingExtraError
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.types import EventPacket

SIGNATURE = b"#!AER-DAT4.0\r\n"
EVENT = np.dtype(
    {
        "names": ["t", "x", "y", "on"],
        "formats": ["<i8", "<i2", "<i2", "?"],
        "offsets": [0, 8, 10, 12],
        "itemsize": 16,
    }
)
STREAM = 0
PACKET_EVENTS = 4_096
"""Events in a packet; readers load a packet at once."""

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


class Aedat4Source(FileSource):
    """Events of the first event stream of an AEDAT4 file.

    Raises:
        MissingExtraError: The library aedat is not installed.
        FormatError: The file cannot be read, or holds no events.
    """

    format = "AEDAT4"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._stream, self._named_size = self._described(path)
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        return self._named_size

    def _columns(self) -> Iterator[Rows]:
        decoder = iter(_decoder(self.path))
        while True:
            try:
                packet = next(decoder, None)
            except Exception:  # the library raises bare exceptions of several kinds
                self.losses.add("truncated")
                return
            if packet is None:
                return
            if packet["stream_id"] == self._stream and "events" in packet:
                events = packet["events"]
                p = events["on"] if "on" in events.dtype.names else events["p"]
                yield events["x"], events["y"], p, events["t"].astype(np.int64)

    def _described(self, path: Path) -> tuple[int, tuple[int, int]]:
        for key, stream in _decoder(path).id_to_stream().items():
            if stream["type"] == "events":
                return int(key), (int(stream["width"]), int(stream["height"]))
        raise FormatError(f"{str(path)!r} holds no stream of events")


class Aedat4Writer:
    """Writes AEDAT4 files packet by packet, uncompressed."""

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        self.size = size
        self._pending = np.zeros(0, EVENT)
        self._file: BinaryIO = open(path, "wb")  # noqa: SIM115
        self._file.write(SIGNATURE + _io_header(_NODE.format(*size).encode("ascii")))

    def write(self, packet: EventPacket) -> None:
        """Append a packet."""
        events = np.zeros(len(packet), EVENT)
        events["t"], events["on"] = packet.t, packet.p
        events["x"], events["y"] = packet.x, packet.y
        events = np.concatenate((self._pending, events))
        whole = len(events) // PACKET_EVENTS * PACKET_EVENTS
        self._put(events[:whole])
        self._pending = events[whole:]

    def close(self) -> None:
        """Complete the file; further calls do nothing."""
        if not self._file.closed:
            self._put(self._pending)
            self._file.close()

    def _put(self, events: np.ndarray[Any, np.dtype[Any]]) -> None:
        for first in range(0, len(events), PACKET_EVENTS):
            data = _event_packet(events[first : first + PACKET_EVENTS])
            self._file.write(struct.pack("<ii", STREAM, len(data)) + data)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _decoder(path: Path) -> Any:
    try:
        from aedat import Decoder  # type: ignore[import-untyped]
    except ImportError as error:
        raise MissingExtraError("AEDAT4 files need: pip install 'spikingtac[formats]'") from error
    try:
        return Decoder(str(path))
    except Exception as error:  # the library raises bare exceptions of several kinds
        raise FormatError(f"{str(path)!r} is no readable AEDAT4 file: {error}") from error


def _io_header(info: bytes) -> bytes:
    """Return the IOHeader: compression and table position at their defaults, and the XML."""
    head = struct.pack("<I4s", 20, b"IOHE")
    vtable = struct.pack("<HHHHH2x", 10, 8, 0, 0, 4)
    table = struct.pack("<iI", 12, 4)
    body = head + vtable + table + struct.pack("<I", len(info)) + info + b"\0"
    body += bytes(-len(body) % 4)
    return struct.pack("<I", len(body)) + body


def _event_packet(events: np.ndarray[Any, np.dtype[Any]]) -> bytes:
    """Return an EventPacket: one vector of event structures, at a multiple of eight bytes."""
    head = struct.pack("<I4s", 16, b"EVTS")
    vtable = struct.pack("<HHH2x", 6, 8, 4)
    table = struct.pack("<iI4x", 8, 8)
    body = head + vtable + table + struct.pack("<I", len(events)) + events.tobytes()
    return struct.pack("<I", len(body)) + body
