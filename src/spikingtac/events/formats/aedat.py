"""AEDAT 2.0 files of jAER, and 3.1 files of cAER: DVS events and trigger edges.

Source: iniVation, "AEDAT file formats" (public). AEDAT 2.0: lines of text, then pairs of 32-bit
words, most significant byte first: an address and a time, us. Columns and rows are counted from
the lower right corner; here from the top left. AEDAT 3.1: lines of text up to ``#!END-HEADER``,
then packets of one type each, little-endian.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from spikingtac.errors import FormatError
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.events.formats.limits import refuse_piece
from spikingtac.events.formats.time_course import unwrapped

# Chips whose names stand in the header.
SIZES_PX = {
    "dvs128": (128, 128), "davis128": (128, 128), "davis208": (208, 192), "davis240": (240, 180),
    "davis346": (346, 260), "davis640": (640, 480), "davishet640": (640, 480),
    "dvxplorer": (640, 480), "dvs132": (132, 104),
}  # fmt: skip
HEADER_LIMIT_BYTES = 1 << 20
LINE_LIMIT = 1 << 12
CHUNK_WORDS = 1 << 17
WORD = np.dtype([("address", ">u4"), ("t", ">u4")])

POLARITY, SPECIAL = 1, 0

# Type, source, bytes of an event, offset of its time, overflows of the time, capacity, number of
# events, number of valid ones.
PACKET = struct.Struct("<hhiiiiii")
EVENT = np.dtype([("data", "<u4"), ("t", "<u4")])
TIME_BITS = 31

# Type of a special event -> external input.
EDGES = {2: 0, 3: 0, 4: 0, 6: 1, 7: 1, 8: 1, 9: 2, 10: 2, 11: 2}
FALLING = (3, 7, 10)  # Types that tell the end of a signal; the others are its begin, or a pulse.


class _Aedat(FileSource):
    def __init__(self, path: Path, options: ReadOptions) -> None:
        with path.open("rb") as file:
            self._header = _header_lines(file)
            self._start = file.tell()
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        size = _named_size(self._header)
        return size or self._size_from_events()


class Aedat2Source(_Aedat):
    """Events of an AEDAT 2.0 file; samples of frames and IMU are counted as ``other_data``.

    Raises:
        FormatError: The header names no chip whose addresses are known.
    """

    format = "AEDAT 2.0"

    def _size(self) -> tuple[int, int]:
        size = _named_size(self._header)
        if size is None:
            raise FormatError(
                f"{str(self.path)!r} names no chip whose addresses are known in its header line "
                f"'# AEChip:' (valid: {', '.join(SIZES_PX)})"
            )
        return size

    def _columns(self) -> Iterator[Rows]:
        width, height = _named_size(self._header) or self.size
        dvs128 = (width, height) == (128, 128) and "davis" not in self._header.lower()
        total, epoch_us, last = max(self.path.stat().st_size, 1), 0, None
        with self.path.open("rb") as file:
            file.seek(self._start)
            while data := file.read(CHUNK_WORDS * WORD.itemsize):
                usable = len(data) // WORD.itemsize * WORD.itemsize
                self.losses.add("truncated", int(usable < len(data)))
                self.progress = file.tell() / total
                words = np.frombuffer(data[:usable], WORD)
                address, t = words["address"].astype(np.int64), words["t"].astype(np.int64)
                if not len(t):
                    continue
                t, epoch_us, last = unwrapped(t, epoch_us, int(t[0]) if last is None else last)
                if dvs128:
                    dvs, on = address & 0x8000 == 0, address & 1 == 0
                    x, y = (address >> 1) & 0x7F, (address >> 8) & 0x7F
                else:
                    dvs, on = address & (1 << 31 | 1 << 10) == 0, address & 1 << 11 != 0
                    x, y = (address >> 12) & 0x3FF, (address >> 22) & 0x1FF
                self.losses.add("other_data", int(len(dvs) - np.count_nonzero(dvs)))
                yield width - 1 - x[dvs], height - 1 - y[dvs], on[dvs], t[dvs]


class Aedat3Source(_Aedat):
    """Events of an AEDAT 3.1 file; packets of frames, IMU and others count as ``other_data``.

    Raises:
        FormatError: A packet is beyond the limit.
    """

    format = "AEDAT 3.1"

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
                if kind not in (POLARITY, SPECIAL) or size != EVENT.itemsize:
                    self.losses.add("other_data", count)
                    file.seek(size * count, 1)
                    continue
                refuse_piece(f"{str(self.path)!r}: a packet", size * count)
                data = file.read(size * count)
                self.losses.add("truncated", int(len(data) < size * count))
                events = np.frombuffer(data[: len(data) // size * size], EVENT)
                events = events[events["data"] & 1 == 1]
                t = (events["t"] & 0x7FFFFFFF).astype(np.int64) + (overflows << TIME_BITS)
                word = events["data"].astype(np.int64)
                self.progress = file.tell() / total
                if kind == SPECIAL:
                    self._take_special((word >> 1) & 0x7F, t)
                else:
                    yield word >> 17, (word >> 2) & 0x7FFF, word & 2 != 0, t

    def _take_special(self, kinds: np.ndarray, t: np.ndarray) -> None:
        edges = np.isin(kinds, list(EDGES))
        channels = [EDGES[kind] for kind in kinds[edges].tolist()]
        self.triggers.append(t[edges], channels, ~np.isin(kinds[edges], FALLING))
        self.losses.add("trigger", len(channels))


def aedat_version(path: Path) -> int:
    """Return 2 or 3 for a file that begins with ``#!AER-DAT``.

    Raises:
        FormatError: It is of another version.
    """
    with path.open("rb") as file:
        line = file.readline(LINE_LIMIT).decode("latin-1").strip()
    found = re.fullmatch(r"#!AER-DAT([23])\.\d", line)
    if found is None:
        raise FormatError(f"{str(path)!r} begins with {line!r}; AEDAT 2.0, 3.1 and 4.0 are read")
    return int(found[1])


def _header_lines(file: BinaryIO) -> str:
    """Return the lines that begin with #, and leave the file at the first word."""
    lines = b""
    while len(lines) < HEADER_LIMIT_BYTES:
        start = file.tell()
        line = file.readline(LINE_LIMIT)
        if not (line.startswith(b"#") and line.endswith(b"\n")):
            file.seek(start)
            break
        lines += line
        if line.startswith(b"#!END-HEADER"):
            break
    return lines.decode("latin-1")


def _named_size(header: str) -> tuple[int, int] | None:
    """Return the size of the chip that the header names, px."""
    for line in header.splitlines():
        if re.match(r"#\s*(AEChip|Source|HardwareInterface)", line, re.IGNORECASE):
            name = line.rpartition(".")[2] if "AEChip" in line else line
            plain = re.sub(r"[^a-z0-9]", "", name.lower())
            for chip, size in SIZES_PX.items():
                if chip in plain:
                    return size
    return None
