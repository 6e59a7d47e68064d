"""A GenX320 on an OpenMV board, through the maker's library ``openmv`` (Camera Protocol V2).

The script that the board runs is shipped with this package and sent each time. It hands out raw
EVT2 words, 4 bytes an event, in transfers of a fixed number of words: at a low rate a transfer
takes long to fill, at a high one small transfers limit the rate. ``words`` sets the number.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from importlib.resources import files
from typing import Any, ClassVar, Self, TypeVar

from spikingtac.cameras.libraries import openmv_ports, require
from spikingtac.cameras.words import GENX320_SIZE, BareWords
from spikingtac.errors import CameraLostError, ConfigError, DeviceError
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.evt.words import Rows

T = TypeVar("T")

SCRIPT = "genx320_on_openmv.micropython"
CHANNEL = "events"

# Words of one transfer unless the address names another number; what the firmware accepts.
WORDS, FEWEST_WORDS, MOST_WORDS = 2048, 1024, 65536

# Longest time that the script may take to start, s (the sensor's reset takes under two).
SCRIPT_S = 8.0
STOP_S = 0.5  # Wait after the running script was stopped, s; that of the maker's examples.
POLL_S = 0.001


class OpenMvCamera(Camera):
    """Raw words of the board's channel ``events``."""

    OPTIONS: ClassVar[tuple[str, ...]] = ("words",)
    EXTRA: ClassVar[str] = "openmv"
    checked = True

    def __init__(self, device: Any, address: Address, words: int) -> None:
        super().__init__()
        self._device: Any = device
        self._words = BareWords(Address(kind=address.kind), self.losses, self.triggers)
        self.size = GENX320_SIZE
        self._transfer = words
        self._about = self._ask(lambda: (device.verinfo, device.sysinfo))
        self._start(words)

    @classmethod
    def open(cls, address: Address) -> Self:
        """Connect, and start the script on the board; see :meth:`Camera.open`."""
        words = int(address.number("words", WORDS, FEWEST_WORDS, MOST_WORDS))
        if words & (words - 1):
            raise ConfigError(f"{str(address)!r}: words is {words}, it must be a power of two")
        library = require("openmv.camera", "openmv", "openmv")
        if sys.version_info < (3, 12):
            _mend(library)
        port = address.target or next((port for port, _ in openmv_ports()), "")
        if not port:
            raise DeviceError(
                "no OpenMV board is plugged in; connect one, or name its port: openmv:/dev/ttyACM0"
            )
        device = library.Camera(port, baudrate=921600, crc=False, ack=False)
        try:
            device.connect()
        except (Exception, SystemExit) as error:
            raise DeviceError(
                f"no OpenMV board with firmware 5.0 or later answers at {port!r} ({error}); check "
                "the cable, close OpenMV IDE, and see that you may open the port (group dialout)"
            ) from error
        try:
            return cls(device, address, words)
        except BaseException:
            with contextlib.suppress(Exception):
                device.disconnect()
            raise

    def read(self, timeout_s: float) -> Rows | None:
        """Return the events of the next transfer; see :meth:`Camera.read`."""
        if self._device is None:
            return None
        until_s = time.monotonic() + timeout_s
        # The size tells whether a transfer waits: each question costs a way there and back.
        while not (size := self._ask(lambda: self._device.channel_size(CHANNEL))):
            if time.monotonic() >= until_s:
                return self.nothing()
            time.sleep(POLL_S)
        data = self._ask(lambda: self._device.channel_read(CHANNEL, size))
        return self._words.feed(data) if data else self.nothing()

    def close(self) -> None:
        """Stop the script and leave the port."""
        device, self._device = self._device, None
        if device is not None:
            with contextlib.suppress(Exception, SystemExit):
                device.stop()
            with contextlib.suppress(Exception):
                device.disconnect()

    def describe(self) -> dict[str, Any]:
        """Return firmware, board and transfer."""
        version, system = self._about
        return {
            "model": "GenX320 on an OpenMV board",
            "firmware": ".".join(map(str, version["firmware_version"])),
            "protocol": ".".join(map(str, version["protocol_version"])),
            "serial": "".join(f"{word:08X}" for word in system["device_id"]),
            "words_per_transfer": self._transfer,
            **self._words.describe(),
        }

    def _start(self, words: int) -> None:
        """Send the script, and wait for its channel."""
        script = files("spikingtac.cameras").joinpath(SCRIPT).read_text(encoding="utf-8")
        script = script.replace(f"WORDS = {WORDS}", f"WORDS = {words}", 1)
        self._ask(self._device.stop)
        time.sleep(STOP_S)
        self._ask(lambda: self._device.exec(script))
        until_s, said = time.monotonic() + SCRIPT_S, ""
        while not self._ask(lambda: self._device.has_channel(CHANNEL)):
            if self._ask(self._device.read_status).get("stdout"):
                said += self._ask(self._device.read_stdout) or ""
            if time.monotonic() > until_s or "Error" in said:
                raise DeviceError(
                    "the board does not stream events; it needs firmware 5.0 or later and a "
                    f"GenX320 module. It says: {said.strip() or 'nothing'}"
                )
            time.sleep(0.02)

    @staticmethod
    def _ask(question: Callable[[], T]) -> T:
        """Return the board's answer.

        The library ends the whole process where the port fails, so its exit is an error here.

        Raises:
            CameraLostError: There is none.
        """
        try:
            return question()
        except (Exception, SystemExit) as error:
            raise CameraLostError(f"the OpenMV board no longer answers ({error!r})") from error


def _mend(library: Any) -> None:
    """Replace two functions of openmv 1.0.7 that fail on Python 3.11, though it says 3.8 will do.

    Both ask whether a number is ``in`` an enumeration, in order to write a line into the log; that
    raises TypeError before 3.12.
    """
    library.Transport.log = lambda *_, **__: None
    library.Camera._handle_event = _count_registered


def _count_registered(device: Any, channel: int, event: int) -> None:
    """Note that the board has new channels: the one event that matters here."""
    if channel == 0 and event == 0:
        device.pending_channel_events += 1
