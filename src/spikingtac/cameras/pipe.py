"""A named pipe or standard input that carries RAW: whatever writes it is a camera."""

from __future__ import annotations

import io
import os
import select
import stat
import sys
import time
from pathlib import Path
from typing import Any, ClassVar, Self

from spikingtac.cameras.words import warm_up
from spikingtac.errors import (
    CameraLostError,
    ConfigError,
    DeviceError,
    FormatError,
    RecordingError,
)
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.evt.header import HEADER_LIMIT_BYTES, RawHeader, read_header
from spikingtac.events.evt.raw import NAMES
from spikingtac.events.evt.words import Rows, WordDecoder, WordStream

CHUNK_BYTES = 1 << 18  # Most bytes that one read takes and decodes.
END_OF_HEADER = b"% end\n"

# Longest wait for a writer and its header, s (ours: a camera's software starts in a few).
PATIENCE_S = 30.0


class PipeCamera(Camera):
    """RAW words from a pipe, in the encoding that their header names."""

    OPTIONS: ClassVar[tuple[str, ...]] = ()
    checked = True

    def __init__(self, file: int, header: RawHeader, pending: bytes, name: str) -> None:
        super().__init__()
        if header.encoding is None or header.size is None:
            os.close(file)
            raise FormatError(
                f"the stream of {name!r} must begin with a header that names encoding and size: "
                "'% evt 3.0', '% geometry 320x320', '% end', one line each"
            )
        self.size = header.size
        self._file: int | None = file
        self._encoding, self._base_us = header.encoding, header.time_base_us
        continuous = header.encoding == "evt3" and header.generated_here
        order = header.byte_order or "little"
        decoder = WordDecoder(header.encoding, header.size, order, continuous)
        warm_up(header.encoding, header.size, order)
        self._stream = WordStream(decoder, self.losses, self.triggers)
        self._pending = pending
        self._ended = False

    @classmethod
    def open(cls, address: Address) -> Self:
        """Wait for the writer and its header; see :meth:`Camera.open`."""
        file = _opened(address)
        try:
            lines, pending = _header(file, address)
        except BaseException:
            os.close(file)
            raise
        return cls(file, read_header(io.BytesIO(lines)), pending, str(address))

    def read(self, timeout_s: float) -> Rows | None:
        """Return what the pipe holds; see :meth:`Camera.read`."""
        if self._file is None or self._ended:
            return None
        data, self._pending = self._pending, b""
        if not data:
            data = _read(self._file, timeout_s)
        if data is None:
            return self.nothing()
        self._ended = not data
        x, y, p, t = self._stream.feed(data, final=self._ended)
        if self._ended and not len(t):
            return None
        return x, y, p, t + self._base_us if self._base_us else t

    def close(self) -> None:
        """Leave the pipe."""
        file, self._file = self._file, None
        if file is not None:
            os.close(file)

    def describe(self) -> dict[str, Any]:
        """Return the encoding."""
        return {"encoding": NAMES[self._encoding]}


def _opened(address: Address) -> int:
    if address.target in ("-", ""):
        if sys.stdin.isatty():
            raise DeviceError("standard input is a terminal; pipe RAW into it, or name a pipe")
        return os.dup(sys.stdin.fileno())
    path = Path(address.target)
    if not path.exists():
        raise DeviceError(f"there is no pipe {str(path)!r}; make it with: mkfifo {path}")
    mode = path.stat().st_mode
    if not (stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)):
        raise ConfigError(f"{str(path)!r} is no pipe; name a file without 'pipe:'")
    # Without waiting, so that Ctrl-C and a deadline work while no writer is there.
    return os.open(path, os.O_RDONLY | os.O_NONBLOCK)


def _header(file: int, address: Address) -> tuple[bytes, bytes]:
    """Return the header and the first bytes after it: up to ``% end``, or to the first word."""
    until_s, data = time.monotonic() + PATIENCE_S, b""
    is_pipe = address.target not in ("-", "")
    while time.monotonic() < until_s and len(data) < HEADER_LIMIT_BYTES:
        piece = _read(file, 0.05)
        data += piece or b""
        header = read_header(io.BytesIO(data))
        rest = data[header.length :]
        complete = data[: header.length].endswith(END_OF_HEADER)
        if complete or (rest and not rest.startswith(b"%")) or (piece == b"" and data):
            return data[: header.length], rest
        if piece == b"":
            if not is_pipe:
                raise RecordingError(f"{str(address)!r} ended before a RAW header came")
            time.sleep(0.01)  # no writer yet, or it has left
    raise CameraLostError(
        f"nothing wrote a RAW header into {str(address)!r} for {PATIENCE_S:g} s; start the "
        "camera's software, and let its header end with a line '% end'"
    )


def _read(file: int, timeout_s: float) -> bytes | None:
    """Return bytes, nothing at the writer's end, or None where nothing came in time."""
    ready, _, _ = select.select([file], [], [], timeout_s)
    if not ready:
        return None
    try:
        return os.read(file, CHUNK_BYTES)
    except BlockingIOError:
        return None
