"""A live copy of a recording for viewers: RAW into a named pipe, without waiting for its reader.

A reader that stalls or leaves costs the recording nothing. What it does not take is counted, and
the copy goes on with words that need nothing of what was left out.
"""

from __future__ import annotations

import contextlib
import os
import stat
import time
from pathlib import Path

from spikingtac.errors import ConfigError
from spikingtac.events.evt.encode import Evt3Encoder
from spikingtac.events.evt.header import format_header
from spikingtac.types import EventPacket

RETRY_S = 0.2
"""Time between two looks whether somebody reads, s."""
PIPE_BYTES = 1 << 20
"""Room that is asked for in the pipe: about 0.1 s at 3 Mev/s."""
PIECE_EVENTS = 512
"""Events that are written at once: at most 4 words of 2 bytes each, so that Linux takes all of a
piece or none of it (pipe(7): PIPE_BUF is 4096), and taken and lost add up."""
F_SETPIPE_SZ = 1031
"""Linux: sets the room of a pipe (fcntl(2)); Python names it from 3.10 on, on Linux alone."""


class LiveCopy:
    """Offers packets to the reader of a named pipe.

    Args:
        path: The pipe; made where it is not there.
        size: ``(width, height)`` of the sensor, px.

    Attributes:
        lost_events: Events that a reader did not take.

    Raises:
        ConfigError: The path is something else than a pipe.
    """

    def __init__(self, path: Path, size: tuple[int, int]) -> None:
        if path.exists() and not stat.S_ISFIFO(path.stat().st_mode):
            raise ConfigError(f"{str(path)!r} is no named pipe; choose another name for --copy")
        self._made = not path.exists()
        if self._made:
            os.mkfifo(path)
        self._path, self._size = path, size
        self._file: int | None = None
        self._looked_s = 0.0
        self._encoder, self._base_us = Evt3Encoder(), 0
        self.lost_events = 0

    def offer(self, packet: EventPacket) -> None:
        """Give a packet to the reader, where there is one that takes it."""
        if not len(packet) or (self._file is None and not self._connected(packet)):
            return
        for first in range(0, len(packet), PIECE_EVENTS):
            piece = slice(first, first + PIECE_EVENTS)
            t = packet.t[piece] - self._base_us
            words = self._encoder.encode(t, packet.x[piece], packet.y[piece], packet.p[piece])
            if not self._took(words.tobytes()):
                self.lost_events += len(packet) - first
                self._encoder = Evt3Encoder()  # its next words name time and row again
                return

    def close(self) -> None:
        """Leave the pipe, and remove it where it was made here."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
        if self._made:
            self._path.unlink(missing_ok=True)

    def _connected(self, packet: EventPacket) -> bool:
        now_s = time.monotonic()
        if now_s - self._looked_s < RETRY_S:
            return False
        self._looked_s = now_s
        try:
            self._file = os.open(self._path, os.O_WRONLY | os.O_NONBLOCK)
        except OSError:  # nobody reads
            return False
        with contextlib.suppress(ImportError, OSError):
            import fcntl

            fcntl.fcntl(self._file, F_SETPIPE_SZ, PIPE_BYTES)
        self._encoder = Evt3Encoder()
        period_bits = self._encoder.time_bits
        self._base_us = (int(packet.t[0]) >> period_bits) << period_bits
        return self._took(format_header("evt3", self._size, self._base_us))

    def _took(self, data: bytes) -> bool:
        """Write a piece; False where the reader does not take it, or has left."""
        if self._file is None:
            return False
        try:
            os.write(self._file, data)
        except BlockingIOError:
            return False
        except OSError:  # the reader has left
            os.close(self._file)
            self._file = None
            return False
        return True
