"""A GenX320 on an OpenMV board, through the maker's library ``openmv`` (Camera Protocol V2).

The script that the board runs is shipped with this package and sent each time. It hands out raw
EVT2 words, 4 bytes an event, in transfers of a fixed number of words: at a low rate a transfer
takes long to fill, at a high one small transfers limit the rate. ``words`` sets the number.
"""

import contextlib
import sys
import time
from collections.abc import Callable, Iterable
from importlib.resources import files
from typing import Any, ClassVar, Self

from spikingtac.cameras.libraries import LibraryCamera, openmv_boards, require
from spikingtac.cameras.words import GENX320_SIZE, CameraWords
from spikingtac.errors import ConfigError, DeviceError
from spikingtac.events.camera import Address
from spikingtac.events.evt.raw import RawHeader
from spikingtac.events.evt.words import Rows

SCRIPT = "genx320_on_openmv.micropython"
CHANNEL = "events"

# Words of one transfer unless the address names another number; what the firmware accepts.
WORDS, FEWEST_WORDS, MOST_WORDS = 2048, 1024, 65536

# Longest time that the script may take to start, s (the sensor's reset takes under two).
SCRIPT_S = 8.0
STOP_S = 0.5  # Wait after the running script was stopped, s; that of the maker's examples.


class OpenMvCamera(LibraryCamera):
    """Raw words of the board's channel ``events``."""

    OPTIONS: ClassVar[tuple[str, ...]] = ("words",)
    POLL_S = 0.001
    checked = True

    def __init__(self, device: Any, words: int) -> None:
        super().__init__(device)
        self._words = CameraWords(
            RawHeader(encoding="evt2", size=GENX320_SIZE), self.losses, self.triggers
        )
        self.size = GENX320_SIZE
        version, system = device.verinfo, device.sysinfo
        self.about = {
            "model": "GenX320 on an OpenMV board",
            "firmware": ".".join(map(str, version["firmware_version"])),
            "protocol": ".".join(map(str, version["protocol_version"])),
            "serial": "".join(f"{word:08X}" for word in system["device_id"]),
            "words_per_transfer": words,
            **self._words.describe(),
        }
        self._start(words)

    @classmethod
    def open(cls, address: Address) -> Self:
        """Connect, and start the script on the board; see :meth:`Camera.open`."""
        words = int(address.number("words", WORDS, FEWEST_WORDS, MOST_WORDS))
        if words & (words - 1):
            raise ConfigError(f"{str(address)!r}: words is {words}, it must be a power of two")
        library = require("openmv", "openmv.camera")
        if sys.version_info < (3, 12):
            # openmv 1.0.7 asks whether a number is ``in`` an enumeration in order to write a line
            # into the log, which raises TypeError on 3.11.
            library.Transport.log = lambda *_, **__: None
            library.Camera._handle_event = _count_registered
        boards = () if address.target else openmv_boards()
        port = address.target or next((one.address.partition(":")[2] for one in boards), "")
        if not port:
            raise DeviceError(
                "no OpenMV board is plugged in; connect one, or name its port: openmv:/dev/ttyACM0"
            )
        device = library.Camera(port, baudrate=921600, crc=False, ack=False)
        try:
            device.connect()
            return cls(device, words)
        except (Exception, SystemExit) as error:  # the library ends the process where a port fails
            with contextlib.suppress(Exception):
                device.disconnect()
            if isinstance(error, DeviceError):  # of the script
                raise
            raise DeviceError(
                f"no OpenMV board with firmware 5.0 or later answers at {port!r} ({error}); check "
                "the cable, close OpenMV IDE, and see that you may open the port (group dialout)"
            ) from error

    def _waiting(self) -> Rows | None:
        # The size tells whether a transfer waits: each question costs a way there and back.
        size = self._device.channel_size(CHANNEL)
        data = self._device.channel_read(CHANNEL, size) if size else b""
        return self._words.feed(data) if data else None

    def _farewell(self, device: Any) -> Iterable[Callable[[], object]]:
        return device.stop, device.disconnect

    def _start(self, words: int) -> None:
        """Send the script, and wait for its channel."""
        device = self._device
        script = files("spikingtac.cameras").joinpath(SCRIPT).read_text(encoding="utf-8")
        device.stop()
        time.sleep(STOP_S)
        device.exec(script.replace(f"WORDS = {WORDS}", f"WORDS = {words}", 1))
        until_s, said = time.monotonic() + SCRIPT_S, ""
        while not device.has_channel(CHANNEL):
            if device.read_status().get("stdout"):
                said += device.read_stdout() or ""
            if time.monotonic() > until_s or "Error" in said:
                raise DeviceError(
                    "the board does not stream events; it needs firmware 5.0 or later and a "
                    f"GenX320 module. It says: {said.strip() or 'nothing'}"
                )
            time.sleep(0.02)


def _count_registered(device: Any, channel: int, event: int) -> None:
    """Note that the board has new channels: the one event that matters here."""
    if channel == 0 and event == 0:
        device.pending_channel_events += 1
