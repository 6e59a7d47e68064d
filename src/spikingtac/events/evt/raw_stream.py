"""RAW words that arrive while they are read: a named pipe, a device, standard input.

Whatever writes RAW can so be a camera: the maker's own software, a bridge on a microcontroller, or
a program that replays a file.
"""

from __future__ import annotations

import io
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import cast

from spikingtac.errors import FormatError, RecordingError
from spikingtac.events.address import is_address
from spikingtac.events.evt.header import HEADER_LIMIT_BYTES, LINE_LIMIT, read_header
from spikingtac.events.evt.raw import CHUNK_BYTES, SAMPLE_BYTES, RawSource
from spikingtac.events.formats.file_source import ReadOptions, Rows

STANDARD_INPUT = "-"  # The path that means standard input.

# With fewer bytes at hand the header's word is taken for the encoding.
LEAST_SAMPLE_BYTES = 1 << 12


def is_stream(path: Path) -> bool:
    """Return whether a path names something that can be read once, as it comes.

    That is standard input, a named pipe, a character device, or the address of a camera.
    """
    if str(path) == STANDARD_INPUT or is_address(path):
        return True
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)


class RawStream(RawSource):
    """Events of a RAW stream, each packet as soon as its words are here.

    The last microsecond waits for the next words, since more of it may follow. A stream can be
    iterated once.

    Raises:
        FormatError: The header names no size, and none was given; or as :class:`RawSource`.
        RecordingError: Standard input is a terminal, or the stream is read a second time.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._spent = False
        self._reader = _opened(path)
        try:
            super().__init__(path, options)
        except BaseException:
            self._reader.close()
            raise

    def _begin(self, path: Path) -> bytes:
        """Wait for the header and the first words; keep those for the iteration."""
        head = io.BytesIO(_header_lines(self._reader))
        self.header = read_header(head)
        wait = self._reader.read if self.header.encoding is None else self._reader.read1
        self._pending = head.read() + wait(SAMPLE_BYTES)
        known = self.header.encoding is not None and len(self._pending) < LEAST_SAMPLE_BYTES
        return b"" if known else self._pending

    def _size(self) -> tuple[int, int]:
        if self.header.size is None:
            raise FormatError(
                f"the stream {str(self.path)!r} names no size in its header, and it cannot be read "
                "twice to find one; let the writer send a line '% geometry 320x320' first"
            )
        return self.header.size

    def _columns(self) -> Iterator[Rows]:
        if self._spent:
            raise RecordingError(
                f"the stream {str(self.path)!r} can be read only once, as it comes; record it "
                "into a file for what needs a second look"
            )
        self._spent = True
        stream = self._words()
        with self._reader as reader:
            data = self._pending or reader.read1(CHUNK_BYTES)
            while data:
                yield stream.feed(data)
                data = reader.read1(CHUNK_BYTES)
            yield stream.feed(b"", final=True)


def _opened(path: Path) -> io.BufferedReader:
    standard = str(path) == STANDARD_INPUT
    if standard and sys.stdin.isatty():
        raise RecordingError(
            "standard input is a terminal; pipe RAW events into it, or name a file"
        )
    reader = sys.stdin.buffer if standard else path.open("rb", buffering=SAMPLE_BYTES)
    return cast(io.BufferedReader, reader)


def _header_lines(reader: io.BufferedReader) -> bytes:
    """Return the lines that begin with %, up to ``% end``; the last may be words already."""
    lines = b""
    while len(lines) < HEADER_LIMIT_BYTES and reader.peek(1)[:1] == b"%":
        line = reader.readline(LINE_LIMIT)
        lines += line
        if line.split() == [b"%", b"end"] or not line.endswith(b"\n"):
            break
    return lines
