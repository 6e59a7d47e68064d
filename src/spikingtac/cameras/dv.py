"""iniVation's cameras and network streams, through the maker's library ``dv-processing``."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from spikingtac.cameras.libraries import require
from spikingtac.errors import CameraLostError, DeviceError
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.formats.file_source import Rows

AT_ONCE = 64  # Batches that one read takes at most.
POLL_S = 0.0002  # Sleep between two looks for a batch, s; the library's reader has no waiting call.

# Settings of a DVXplorer -> their getters.
THRESHOLDS = {
    "contrast_threshold_on": "getContrastThresholdOn",
    "contrast_threshold_off": "getContrastThresholdOff",
}


class DvCamera(Camera):
    """Batches of a DVXplorer or DAVIS, or of a program that writes them to the network."""

    EXTRA: ClassVar[str] = "dv"

    def __init__(self, reader: Any, about: dict[str, Any]) -> None:
        super().__init__()
        self._reader: Any = reader
        if not reader.isEventStreamAvailable():
            raise DeviceError(f"{about['model']!r} sends no events; choose its event stream")
        width, height = reader.getEventResolution()
        self.size = int(width), int(height)
        self._about = about

    @classmethod
    def open(cls, address: Address) -> Self:
        """Open a camera, or connect to a network writer; see :meth:`Camera.open`."""
        library = require("dv_processing", "dv-processing", "dv")
        reader = _network(library, address) or _plugged_in(library, address.target)
        about = {
            "model": reader.getCameraName(),
            "library": f"dv-processing {library.__version__}",
        }
        serial = _told(reader, "getSerialNumber")
        about |= {"serial": str(serial)} if serial else {}
        return cls(reader, about)

    def read(self, timeout_s: float) -> Rows | None:
        """Return the next batch; see :meth:`Camera.read`."""
        until_s = time.monotonic() + timeout_s
        while self._reader is not None:
            batches = self._waiting()
            if batches:
                events = np.concatenate([batch.numpy() for batch in batches])
                return events["x"], events["y"], events["polarity"], events["timestamp"]
            if time.monotonic() >= until_s:
                return self.nothing()
            time.sleep(POLL_S)
        return None

    def _waiting(self) -> list[Any]:
        """Return the batches that are here; many small ones are faster together."""
        batches: list[Any] = []
        try:
            while (
                len(batches) < AT_ONCE and (batch := self._reader.getNextEventBatch()) is not None
            ):
                if not batch.isEmpty():
                    batches.append(batch)
            running = bool(batches) or self._reader.isRunning()
        except RuntimeError as error:
            if batches:
                return batches  # the next call says it again
            raise CameraLostError(f"{self._about['model']} is gone ({error})") from error
        if not running:
            raise CameraLostError(
                f"{self._about['model']} is gone: unplugged, or its program has ended"
            )
        return batches

    def close(self) -> None:
        """Leave the camera."""
        self._reader = None

    def describe(self) -> dict[str, Any]:
        """Return model and library."""
        return self._about

    def biases(self) -> dict[str, int]:
        """Return a DVXplorer's contrast thresholds; a DAVIS and a network stream tell none."""
        told = {name: _told(self._reader, getter) for name, getter in THRESHOLDS.items()}
        return {name: int(value) for name, value in told.items() if value is not None}

    def roi(self) -> list[list[int]]:
        """Return the window that sends; empty where the camera does not tell."""
        area = _told(self._reader, "getCropArea")
        return [] if area is None else [[int(value) for value in area]]


def _told(reader: Any, getter: str) -> Any:
    """Return what a getter tells; None where this kind of reader has none, or it fails."""
    with contextlib.suppress(AttributeError, RuntimeError):
        return getattr(reader, getter)()
    return None


def _network(library: Any, address: Address) -> Any:
    """Return the reader of ``//HOST:PORT`` or of a local socket's path; None for other targets."""
    if ":" in address.target:
        host, port = address.host_port("127.0.0.1")
        return _tried(lambda: library.io.NetworkReader(host, port), str(address))
    if address.target and Path(address.target).exists():
        return _tried(lambda: library.io.NetworkReader(Path(address.target)), str(address))
    return None


def _plugged_in(library: Any, serial: str) -> Any:
    """Return the camera of a serial number, or the first one."""
    found = library.io.camera.discover()
    if not found:
        raise DeviceError(
            "no camera of iniVation is plugged in; check cable and udev rules (spikingtac doctor), "
            "or name a network stream: dv://127.0.0.1:7777"
        )
    if not serial:
        return _tried(library.io.camera.open, "dv:")
    return _tried(lambda: library.io.camera.open(serial), f"dv:{serial}")


def _tried(opening: Any, name: str) -> Any:
    try:
        return opening()
    except (RuntimeError, IndexError, OSError) as error:
        why = str(error).partition(" [")[0]  # the library adds where in its sources it happened
        raise DeviceError(f"{name!r} cannot be opened ({why}); is it there, and free?") from error
