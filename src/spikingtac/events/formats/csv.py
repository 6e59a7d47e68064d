"""Event tables as text: t, x, y, p by comma, semicolon, tab or space, with or without a header."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import WholeFile
from spikingtac.errors import FormatError
from spikingtac.events.formats.checks.time_unit import US_PER_S, in_seconds
from spikingtac.events.formats.codec import EventWriter
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.types import EventPacket

CHUNK_BYTES = 1 << 20
SAMPLE_BYTES = 1 << 16
"""First rows that tell how many columns there are, and whether times are seconds."""
_NAMES = {
    "t": "t", "time": "t", "timestamp": "t", "timestamps": "t", "t_us": "t", "ts": "t",
    "time_us": "t", "timestamp_us": "t", "x": "x", "col": "x", "column": "x", "y": "y",
    "row": "y", "p": "p", "pol": "p", "polarity": "p", "on": "p", "is_increase": "p",
}  # fmt: skip
_TRUTH: dict[str, Any] = {"true": "1", "false": "0"}
_VALUES = (*_TRUTH, "nan", "inf")
_SPLIT = re.compile(r"[,;\t ]+")
_BYTE_ORDER_MARK = "\ufeff"
"""What some programs begin UTF-8 with."""


class CsvSource(FileSource):
    """Events of a text table.

    A header names the columns in any order; without one the order is t, x, y, p. A ``# size W H``
    comment gives the size. Times are seconds where some of the first ones are no whole numbers.
    Polarity is 1 and 0, 1 and -1, or true and false. Lines that do not parse, or have another
    number of columns than most, are counted as ``bad_record``.
    """

    format = "CSV"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._order = "txyp"
        self._scale = 1
        self._named_size: tuple[int, int] | None = None
        self._start = self._read_head(path)
        super().__init__(path, options)

    def _size(self) -> tuple[int, int]:
        return self._named_size or self._size_from_events()

    def _read_head(self, path: Path) -> int:
        """Read comments and the header; return the offset of the first line of numbers."""
        with path.open("rb") as file:
            while line := file.readline(CHUNK_BYTES):
                text = line.decode("utf-8", "replace").strip().removeprefix(_BYTE_ORDER_MARK)
                size = re.fullmatch(r"#\s*size[\s:=]+(\d+)[\sx,]+(\d+)", text)
                if size:
                    self._named_size = (int(size[1]), int(size[2]))
                if not text or text.startswith(("#", "%")):
                    continue
                words = _SPLIT.split(text)
                if any(
                    re.match(r"[A-Za-z_]", word) and word.lower() not in _VALUES for word in words
                ):
                    self._order = _columns_named(words, path)
                    continue
                start = file.tell() - len(line)
                self._look_at(line + file.read(SAMPLE_BYTES))
                return start
            return file.tell()

    def _look_at(self, sample: bytes) -> None:
        """Learn from the first rows how many columns there are, and the unit of the times."""
        rows = [
            _SPLIT.split(_trimmed(line)) for line in sample.decode("utf-8", "replace").split("\n")
        ]
        columns = Counter(map(len, rows[: max(len(rows) - 1, 1)])).most_common(1)[0][0]
        self._order += "-" * (columns - len(self._order))
        place = self._order.index("t")
        times = [_number(row[place]) for row in rows if len(row) == columns]
        if in_seconds(np.array(times, np.float64)):
            self._scale = US_PER_S

    def _columns(self) -> Iterator[Rows]:
        with self.path.open("rb") as file:
            file.seek(self._start)
            tail = b""
            while data := file.read(CHUNK_BYTES):
                complete, newline, rest = (tail + data).rpartition(b"\n")
                if newline or len(rest) < CHUNK_BYTES:
                    tail = rest
                else:
                    self.losses.add("bad_record")
                    tail = b""
                yield from self._parsed(complete)
            yield from self._parsed(tail)

    def _parsed(self, text: bytes) -> Iterator[Rows]:
        lines = [line for line in text.decode("utf-8", "replace").splitlines() if line.strip()]
        if lines:
            rows = _rows(lines, len(self._order))
            self.losses.add("bad_record", len(lines) - len(rows))
            values = {name: rows[:, place] for place, name in enumerate(self._order)}
            yield values["x"], values["y"], values["p"], values["t"] * self._scale


class CsvWriter(EventWriter):
    """Writes event tables: ``# size W H``, the header ``t,x,y,p``, times in us."""

    def __init__(self, path: str | Path, size: tuple[int, int]) -> None:
        self.size = size
        self._target = WholeFile(path)
        self._file = self._target.begin(f"# size {size[0]} {size[1]}\nt,x,y,p\n".encode())

    def write(self, packet: EventPacket) -> None:
        """Append a packet."""
        table = np.column_stack((packet.t, packet.x, packet.y, packet.p.astype(np.int64)))
        np.savetxt(self._file, table, "%d", ",")

    def close(self) -> None:
        """Complete the file; further calls do nothing."""
        if not self._file.closed:
            self._target.commit(self._file)

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._target.abandon(self._file)


def _columns_named(words: list[str], path: Path) -> str:
    names = [_NAMES.get(word.strip("\"' ").lower(), "-") for word in words]
    if sorted(name for name in names if name != "-") != ["p", "t", "x", "y"]:
        raise FormatError(
            f"{str(path)!r}: the header {','.join(words)!r} does not name t, x, y and p once each; "
            "name the columns so, or leave the header out (then the order is t,x,y,p)"
        )
    return "".join(names)


def _rows(lines: list[str], columns: int) -> NDArray[np.float64]:
    """Return the lines that parse, ``(n, columns)``: at once if all do, else one by one."""
    text = _SPLIT.sub(" ", "\n".join(map(_trimmed, lines)))
    try:
        if not _regular(text, columns):
            raise ValueError("lines of different lengths")
        return _finite(np.array(text.split(), np.float64).reshape(len(lines), columns))
    except ValueError:
        rows = [row for line in lines if (row := _row(line, columns)) is not None]
        return _finite(np.array(rows, np.float64).reshape(-1, columns))


def _row(line: str, columns: int) -> list[float] | None:
    words = [_TRUTH.get(word.lower(), word) for word in _SPLIT.split(_trimmed(line))]
    if len(words) != columns:
        return None
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return float("nan")


def _finite(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    bounded = np.isfinite(rows).all(axis=1) & (np.abs(rows) < 1e18).all(axis=1)
    return rows[bounded]


def _trimmed(line: str) -> str:
    """Return a line without quotes, blanks at its ends and separators after its last word."""
    return line.replace('"', "").rstrip(" \t\r,;").lstrip(f" \t{_BYTE_ORDER_MARK}")


def _regular(text: str, columns: int) -> bool:
    """Return whether each line holds so many words, parted by single blanks."""
    characters = np.frombuffer(text.encode("utf-8"), np.uint8)
    ends = np.append(np.flatnonzero(characters == ord("\n")), len(characters))
    blanks = np.searchsorted(np.flatnonzero(characters == ord(" ")), ends)
    return bool((np.diff(blanks, prepend=0) == columns - 1).all())
