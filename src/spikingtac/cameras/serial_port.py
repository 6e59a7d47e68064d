"""EVT words over a serial port without framing, as a microcontroller's USB port carries them.

Needs no library: the port is set to raw bytes by the operating system (not on Windows). Words that
begin in the middle are found by the decoder, which counts what it skipped.
"""

from __future__ import annotations

import contextlib
import os
import select
from typing import Any, ClassVar, Self

from spikingtac.cameras.words import WORD_OPTIONS, BareWords
from spikingtac.errors import CameraLostError, ConfigError, DeviceError
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.evt.words import Rows

CHUNK_BYTES = 1 << 16


class SerialCamera(Camera):
    """EVT2, EVT2.1 or EVT3 words from a serial device."""

    OPTIONS: ClassVar[tuple[str, ...]] = WORD_OPTIONS
    checked = True

    def __init__(self, address: Address) -> None:
        super().__init__()
        self._words = BareWords(address, self.losses, self.triggers)
        self.size = self._words.size
        self._port = address.target
        self._file: int | None = _raw_port(address)

    @classmethod
    def open(cls, address: Address) -> Self:
        """Open the port as raw bytes; see :meth:`Camera.open`."""
        if not address.target:
            raise ConfigError("serial: needs a device, as serial:/dev/ttyACM0?encoding=evt2")
        return cls(address)

    def read(self, timeout_s: float) -> Rows | None:
        """Return the events of the bytes that wait; see :meth:`Camera.read`."""
        if self._file is None:
            return None
        ready, _, _ = select.select([self._file], [], [], timeout_s)
        if not ready:
            return self.nothing()
        try:
            data = os.read(self._file, CHUNK_BYTES)
        except BlockingIOError:
            return self.nothing()
        except OSError as error:
            raise CameraLostError(f"{self._port} is gone ({error.strerror})") from error
        if not data:
            raise CameraLostError(f"{self._port} is gone: the device was unplugged")
        return self._words.feed(data)

    def close(self) -> None:
        """Leave the port."""
        file, self._file = self._file, None
        if file is not None:
            os.close(file)

    def describe(self) -> dict[str, Any]:
        """Return the encoding."""
        return self._words.describe()


def _raw_port(address: Address) -> int:
    try:
        import termios
        import tty
    except ImportError as error:
        raise DeviceError("serial: works on Linux and macOS; use the udp: or pipe: way") from error
    try:
        file = os.open(address.target, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise DeviceError(
            f"{address.target!r} cannot be opened ({error.strerror}); check the cable, and that "
            "you may open the port (group dialout)"
        ) from error
    try:
        tty.setraw(file)
        with contextlib.suppress(termios.error):
            termios.tcflush(file, termios.TCIFLUSH)  # old bytes are of an earlier stream
    except termios.error as error:
        os.close(file)
        raise DeviceError(
            f"{address.target!r} is no serial port; a pipe is read by pipe:"
        ) from error
    return file
