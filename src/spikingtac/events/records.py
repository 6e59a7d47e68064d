"""Files of small records: Prophesee ``.dat``, AEDAT 2.0 and 3.1, Event Stream ``.es``.

Sources, all public: Prophesee, "DAT File Format": a text header, two bytes of type, then 32 bits of
time (us) and, from the lowest bit, 14 of column, 14 of row, 4 of polarity; in version 1, of the
ATIS, 9, 8 and 1. iniVation, "AEDAT file
formats". AEDAT 2.0 of jAER: lines of text, then pairs of 32-bit words, most significant byte first:
an address and a time, us, counted from the lower right corner. AEDAT 3.1 of cAER: lines of text up
to ``#!END-HEADER``, then packets of one type each, little-endian. event_stream, "Specification",
version 2: five bytes an event, seven bits of time since the last one and the polarity, then column
and row, counted from the bottom. The byte 0xFF adds 127 us, 0xFE fills.
"""

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import FormatError
from spikingtac.events.evt.raw import LINE_LIMIT, header_lines, read_header
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.events.formats.packing import Counter
from spikingtac.events.formats.pieces import refuse_piece

CHUNK_BYTES = 1 << 20  # Bytes that are decoded at once.
CD_TYPES = (0x00, 0x0C)  # Types of the events of a .dat file that are read.
DAT_BITS = {"1": (9, 8, 1), "2": (14, 14, 4)}  # Version -> bits of column, row and polarity.
DAT_EVENT = np.dtype([("t", "<u4"), ("address", "<u4")])
AEDAT2_EVENT = np.dtype([("address", ">u4"), ("t", ">u4")])

# Chips whose names stand in the header of an AEDAT file.
SIZES_PX = {
    "dvs128": (128, 128), "davis128": (128, 128), "davis208": (208, 192), "davis240": (240, 180),
    "davis346": (346, 260), "davis640": (640, 480), "davishet640": (640, 480),
    "dvxplorer": (640, 480), "dvs132": (132, 104),
}  # fmt: skip
POLARITY, SPECIAL = 1, 0  # Types of packets of AEDAT 3.1.

# Type, source, bytes of an event, offset of its time, overflows of the time, capacity, number of
# events, number of valid ones.
PACKET = struct.Struct("<hhiiiiii")
AEDAT3_EVENT, AEDAT3_TIME_BITS = np.dtype([("data", "<u4"), ("t", "<u4")]), 31

# Type of a special event -> external input, and whether the signal rose or began a pulse.
EDGES = {
    2: (0, True), 3: (0, False), 4: (0, True), 6: (1, True), 7: (1, False), 8: (1, True),
    9: (2, True), 10: (2, False), 11: (2, True),
}  # fmt: skip

ES_HEADER = struct.Struct("<12s3BBHH")
ES_MAJOR, ES_DVS, ES_EVENT_BYTES = 2, 1, 5
OVERFLOW, FILL, OVERFLOW_US = 0xFF, 0xFE, 127


class _Records(FileSource):
    """A file of records of one type behind a header; their times are 32 bits wide, and wrap."""

    _start = 0
    _record: np.dtype[Any]

    def _records(self) -> Iterator[tuple[NDArray[Any], NDArray[np.int64]]]:
        """Yield some records and their times, us."""
        counter = Counter(1 << 32)
        for data in self._chunks(self._start, CHUNK_BYTES):
            usable = len(data) // self._record.itemsize * self._record.itemsize
            self.losses.add("truncated", int(usable < len(data)))
            records = np.frombuffer(data[:usable], self._record)
            yield records, counter.unwrapped(records["t"])


class DatSource(_Records):
    """Events of a ``.dat`` file; where it names no version, the first addresses tell it."""

    format = "DAT"
    _record = DAT_EVENT

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with path.open("rb") as file:
            header = read_header(file)
            kind = file.read(2)
            self._start = file.tell()
            addresses = np.fromfile(file, DAT_EVENT, CHUNK_BYTES // DAT_EVENT.itemsize)["address"]
        self._named_size = header.size
        long = (addresses >> sum(DAT_BITS["1"])).any()
        version = header.fields.get("Version", "2" if long else "1")
        if version not in DAT_BITS:
            raise FormatError(f"{str(path)!r} is DAT of version {version}; 1 and 2 are read")
        self._bits = DAT_BITS[version]
        if len(kind) == 2 and (kind[0] not in CD_TYPES or kind[1] != DAT_EVENT.itemsize):
            raise FormatError(
                f"{str(path)!r} holds events of type {kind[0]:#x} with {kind[1]} bytes each; "
                "CD events (type 0xc, 8 bytes) are read"
            )
        super().__init__(path, options)

    def _columns(self) -> Iterator[Rows]:
        across, down, _ = self._bits
        x_mask, y_mask, p_mask = ((1 << bits) - 1 for bits in self._bits)
        for events, t in self._records():
            address = events["address"].astype(np.int64)
            yield address & x_mask, address >> across & y_mask, address >> across + down & p_mask, t


class Aedat2Source(_Records):
    """Events of an AEDAT 2.0 file; samples of frames and IMU are counted as ``other_data``.

    Raises:
        FormatError: The header names no chip whose addresses are known.
    """

    format = "AEDAT 2.0"
    _record = AEDAT2_EVENT

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._header, self._start = _aedat_header(path)
        self._named_size = _named_size(self._header)
        if self._named_size is None and options.size is None:
            raise FormatError(
                f"{str(path)!r} names no chip whose addresses are known in its header line "
                f"'# AEChip:' (valid: {', '.join(SIZES_PX)}); convert --size W H (size=) helps"
            )
        super().__init__(path, options)

    def _columns(self) -> Iterator[Rows]:
        width, height = self._named_size or self.size
        dvs128 = (width, height) == (128, 128) and "davis" not in self._header.lower()
        for words, t in self._records():
            address = words["address"].astype(np.int64)
            if dvs128:
                dvs, on = address & 0x8000 == 0, address & 1 == 0
                x, y = (address >> 1) & 0x7F, (address >> 8) & 0x7F
            else:
                dvs, on = address & (1 << 31 | 1 << 10) == 0, address & 1 << 11 != 0
                x, y = (address >> 12) & 0x3FF, (address >> 22) & 0x1FF
            self.losses.add("other_data", int(len(dvs) - np.count_nonzero(dvs)))
            yield width - 1 - x[dvs], height - 1 - y[dvs], on[dvs], t[dvs]


class Aedat3Source(FileSource):
    """Events of an AEDAT 3.1 file; packets of frames, IMU and others count as ``other_data``."""

    format = "AEDAT 3.1"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        header, self._start = _aedat_header(path)
        self._named_size = _named_size(header)
        super().__init__(path, options)

    def _columns(self) -> Iterator[Rows]:
        total = max(self.path.stat().st_size, 1)
        with self.path.open("rb") as file:
            file.seek(self._start)
            while head := file.read(PACKET.size):
                if len(head) < PACKET.size:
                    self.losses.add("truncated")
                    return
                kind, _, size, _, overflows, _, count, _ = PACKET.unpack(head)
                if not (0 <= kind < 64 and size > 0 and count >= 0 and overflows >= 0):
                    self.losses.add("bad_record")
                    return
                if kind in (POLARITY, SPECIAL) and size == AEDAT3_EVENT.itemsize:
                    yield from self._packet(file, kind, size * count, overflows)
                else:
                    self.losses.add("other_data", count)
                    file.seek(min(size * count, total), 1)
                self.progress = file.tell() / total

    def _packet(self, file: BinaryIO, kind: int, length: int, overflows: int) -> Iterator[Rows]:
        refuse_piece(f"{str(self.path)!r}: a packet", length)
        data = file.read(length)
        self.losses.add("truncated", int(len(data) < length))
        events = np.frombuffer(data[: len(data) // 8 * 8], AEDAT3_EVENT)
        events = events[events["data"] & 1 == 1]
        t = (events["t"] & 0x7FFFFFFF).astype(np.int64) + (overflows << AEDAT3_TIME_BITS)
        word = events["data"].astype(np.int64)
        if kind == POLARITY:
            yield word >> 17, (word >> 2) & 0x7FFF, word & 2 != 0, t
            return
        for number, t_us in zip(((word >> 1) & 0x7F).tolist(), t.tolist(), strict=True):
            if number in EDGES:
                self.triggers.append(t_us, *EDGES[number])
                self.losses.add("trigger")


class EsSource(_Records):
    """Events of an ``.es`` file of the DVS type."""

    format = "ES"
    _start = ES_HEADER.size

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with path.open("rb") as file:
            data = file.read(ES_HEADER.size).ljust(ES_HEADER.size, b"\0")
        _, major, minor, patch, kind, width, height = ES_HEADER.unpack(data)
        if (major, kind) != (ES_MAJOR, ES_DVS) or not (width and height):
            raise FormatError(
                f"{str(path)!r} is Event Stream {major}.{minor}.{patch} with events of type {kind} "
                f"on {width}x{height} px; DVS events (type 1) of version 2 are read: convert "
                "others with event_stream"
            )
        self._named_size = (width, height)
        super().__init__(path, options)

    def _columns(self) -> Iterator[Rows]:
        height = self.size[1]
        state, tail = np.zeros(1, np.int64), b""
        for data in self._chunks(self._start, CHUNK_BYTES // 4):
            buffer = np.frombuffer(tail + data, np.uint8)
            room = len(buffer) // ES_EVENT_BYTES + 1
            x, y = np.empty(room, np.int64), np.empty(room, np.int64)
            p, t = np.empty(room, np.bool_), np.empty(room, np.int64)
            count, end = decode_es_kernel(buffer, (x, y, p, t), state)
            tail = buffer[end:].tobytes()
            yield x[:count], height - 1 - y[:count], p[:count], t[:count]
        self.losses.add("truncated", int(bool(tail)))


@njit(cache=True, nogil=True)
def decode_es_kernel(data: NDArray[np.uint8], out: Rows, state: NDArray[np.int64]) -> Any:
    """Decode whole events; return their number and the bytes used. ``state`` is the time, us."""
    x, y, p, t = out
    n, i = 0, 0
    while i < len(data):
        first = np.int64(data[i])
        if first == OVERFLOW:
            state[0] += OVERFLOW_US
            i += 1
        elif first == FILL:
            i += 1
        elif i + 5 <= len(data):
            state[0] += first >> 1
            x[n] = np.int64(data[i + 1]) | (np.int64(data[i + 2]) << 8)
            y[n] = np.int64(data[i + 3]) | (np.int64(data[i + 4]) << 8)
            p[n], t[n] = (first & 1) == 1, state[0]
            n += 1
            i += 5
        else:
            break
    return n, i


def open_aedat(path: Path, options: ReadOptions) -> FileSource:
    """Open a file that begins with ``#!AER-DAT``, or refuse its version."""
    with path.open("rb") as file:
        line = file.readline(LINE_LIMIT).decode("latin-1").strip()
    found = re.fullmatch(r"#!AER-DAT([23])\.\d", line)
    if found is None:
        raise FormatError(f"{str(path)!r} begins with {line!r}; AEDAT 2.0, 3.1 and 4.0 are read")
    return (Aedat2Source if found[1] == "2" else Aedat3Source)(path, options)


def _aedat_header(path: Path) -> tuple[str, int]:
    """Return the lines that begin with #, and where the first word is."""
    with path.open("rb") as file:
        lines = "".join(header_lines(file, b"#"))
    return lines, len(lines)


def _named_size(header: str) -> tuple[int, int] | None:
    """Return the size of the chip that the header names, px."""
    lines = r"^#\s*(?:AEChip.*\.|AEChip|Source|HardwareInterface)(.*)$"
    named = re.findall(lines, header, re.IGNORECASE | re.MULTILINE)
    plain = re.sub(r"[^a-z0-9 ]", "", " ".join(named).lower())
    return next((size for chip, size in SIZES_PX.items() if chip in plain), None)
