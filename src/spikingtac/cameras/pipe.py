"""Words that come as a stream of bytes: RAW from a pipe, bare words from a serial port."""

import contextlib
import io
import os
import select
import stat
import sys
import time
from pathlib import Path
from typing import Any, ClassVar, Self

from spikingtac.cameras.words import WORD_OPTIONS, CameraWords, header_of
from spikingtac.errors import CameraLostError, ConfigError, DeviceError, FormatError, RecordingError
from spikingtac.events.camera import Address, Camera
from spikingtac.events.evt.raw import HEADER_LIMIT_BYTES, RawHeader, read_header
from spikingtac.events.evt.wire import NAMES
from spikingtac.events.evt.words import Rows

CHUNK_BYTES = 1 << 18  # Most bytes that one read takes and decodes.
END_OF_HEADER = b"% end\n"

# Longest wait for a writer and its header, s (a camera's software starts in a few).
PATIENCE_S = 30.0


class PipeCamera(Camera):
    """RAW words from a pipe, in the encoding that their header names: its writer is a camera.

    Args:
        file: Descriptor of the open pipe.
        header: What is known of the words.
        pending: Bytes that came with the header.
    """

    checked = True

    def __init__(self, file: int, header: RawHeader, pending: bytes = b"") -> None:
        super().__init__()
        self._words = CameraWords(header, self.losses, self.triggers)
        self.size = self._words.size
        self._file: int | None = file
        self._pending = pending
        self._ended = self._read_out = False

    @classmethod
    def open(cls, address: Address) -> Self:
        """Wait for the writer and its header; see :meth:`Camera.open`."""
        file = _opened_pipe(address)
        try:
            header, pending = _header(file, address)
            if header.encoding is None or header.size is None:
                raise FormatError(
                    f"the stream of {str(address)!r} must begin with a header that names encoding "
                    "and size: '% evt 3.0', '% geometry 320x320', '% end', one line each"
                )
            camera = cls(file, header, pending)
        except BaseException:
            os.close(file)
            raise
        camera.format = NAMES[header.encoding]
        return camera

    def read(self, timeout_s: float) -> Rows | None:
        """Return what came; see :meth:`Camera.read`."""
        if self._read_out:
            raise RecordingError(
                "a stream can be read only once, as it comes; record it into a file for what "
                "needs a second look"
            )
        if self._file is None or self._ended:
            self._read_out = self._ended
            return None
        data = self._pending or _read(self._file, timeout_s)
        self._pending = b""
        if data is None:
            return self.nothing()
        self._ended = not data
        rows = self._words.feed(data, final=self._ended)
        self._read_out = self._ended and not len(rows[3])
        return None if self._read_out else rows

    def close(self) -> None:
        """Leave it."""
        file, self._file = self._file, None
        if file is not None:
            os.close(file)

    def describe(self) -> dict[str, Any]:
        """Return the encoding."""
        return self._words.describe()


def _opened_pipe(address: Address) -> int:
    if address.target in ("-", ""):
        if sys.stdin is None or sys.stdin.isatty():
            raise DeviceError("standard input is closed or a terminal: pipe RAW in, or name a pipe")
        return os.dup(sys.stdin.fileno())
    path = Path(address.target)
    if not path.exists():
        raise DeviceError(f"there is no pipe {str(path)!r}; make it with: mkfifo {path}")
    mode = path.stat().st_mode
    if not (stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)):
        raise ConfigError(f"{str(path)!r} is no pipe; name a file without 'pipe:'")
    # Without waiting, so that Ctrl-C and a deadline work while no writer is there.
    return os.open(path, os.O_RDONLY | os.O_NONBLOCK)


def _header(file: int, address: Address) -> tuple[RawHeader, bytes]:
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
            return header, rest
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
    with contextlib.suppress(BlockingIOError):
        return os.read(file, CHUNK_BYTES) if ready else None
    return None


class SerialCamera(PipeCamera):
    """EVT2, EVT2.1 or EVT3 words from a serial device, as a microcontroller's USB port sends them.

    Needs no library: the port is set to raw bytes by the operating system (not on Windows). Words
    that begin in the middle are found by the decoder, which counts what it skipped.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = WORD_OPTIONS

    @classmethod
    def open(cls, address: Address) -> Self:
        """Open the port as raw bytes; see :meth:`Camera.open`."""
        if not address.target:
            raise ConfigError("serial: needs a device, as serial:/dev/ttyACM0?encoding=evt2")
        header = header_of(address)
        return cls(_opened_port(address.target), header)

    def read(self, timeout_s: float) -> Rows | None:
        """Return the events of the bytes that wait; see :meth:`Camera.read`."""
        if self._file is None:
            return None
        why = "the device was unplugged"
        try:
            rows = super().read(timeout_s)
        except OSError as error:
            rows, why = None, str(error.strerror)
        if rows is None:
            raise CameraLostError(f"the serial port is gone: {why}")
        return rows


def _opened_port(path: str) -> int:
    import termios
    import tty

    try:
        file = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise DeviceError(
            f"{path!r} cannot be opened ({error.strerror}); check the cable, and that you may "
            "open the port (group dialout)"
        ) from error
    try:
        tty.setraw(file)
        with contextlib.suppress(termios.error):
            termios.tcflush(file, termios.TCIFLUSH)  # old bytes are of an earlier stream
    except termios.error as error:
        os.close(file)
        raise DeviceError(f"{path!r} is no serial port; a pipe is read by pipe:") from error
    return file
