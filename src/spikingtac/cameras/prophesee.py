"""Prophesee's kits, GenX320 and others, through OpenEB's hardware layer ``metavision_hal``.

The words are decoded here, so that every encoding works that the sensor can send.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any, Self

from spikingtac.cameras.libraries import require
from spikingtac.cameras.words import BareWords
from spikingtac.errors import CameraLostError, DeviceError
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.evt.words import Rows

POLL_S = 0.0002  # Sleep between two looks for a buffer, s.

# Names of the hardware layer -> ours.
ENCODINGS = {"EVT2": "evt2", "EVT21": "evt21", "EVT3": "evt3"}

# Sensors that send EVT2.1 as two 32-bit halves, the upper one first.
LEGACY_SENSORS = ("IMX636", "Gen41", "Gen4.1", "Gen3")


class PropheseeCamera(Camera):
    """Raw words of a device of OpenEB."""

    checked = True

    def __init__(self, device: Any) -> None:
        super().__init__()
        geometry, self._stream = device.get_i_geometry(), device.get_i_events_stream()
        self.size = int(geometry.get_width()), int(geometry.get_height())
        self._device: Any = device
        identity = device.get_i_hw_identification()
        encoding = _encoding(identity)
        sensor = str(identity.get_sensor_info().name)
        self._about = {"model": sensor, "serial": str(identity.get_serial())}
        options = {"encoding": encoding, "size": f"{self.size[0]}x{self.size[1]}"}
        if encoding == "evt21" and sensor.startswith(LEGACY_SENSORS):
            options["order"] = "legacy"
        words = Address(kind="prophesee", options=options)
        self._words = BareWords(words, self.losses, self.triggers)
        self._stream.start()

    @classmethod
    def open(cls, address: Address) -> Self:
        """Open the device of a serial number, or the first one; see :meth:`Camera.open`."""
        library = require("metavision_hal", "OpenEB (metavision_hal)", "")
        try:
            device = library.DeviceDiscovery.open(address.target)
        except Exception as error:  # the library raises RuntimeError of many texts
            raise DeviceError(
                f"OpenEB cannot open {address.target or 'a camera'!r} ({error}); check cable, udev "
                "rules, and that no other program has it"
            ) from error
        if device is None:
            raise DeviceError(
                "OpenEB finds no camera; check cable, power and udev rules (spikingtac doctor)"
            )
        return cls(device)

    def read(self, timeout_s: float) -> Rows | None:
        """Return the events of the next buffer; see :meth:`Camera.read`."""
        if self._device is None:
            return None
        until_s = time.monotonic() + timeout_s
        try:
            while (found := self._stream.poll_buffer()) == 0:
                if time.monotonic() >= until_s:
                    return self.nothing()
                time.sleep(POLL_S)
            data = self._stream.get_latest_raw_data() if found > 0 else None
        except Exception as error:
            raise CameraLostError(f"{self._about['model']} is gone ({error})") from error
        if found < 0:
            raise CameraLostError(f"{self._about['model']} is gone: its stream has ended")
        return self.nothing() if data is None else self._words.feed(bytes(data))

    def close(self) -> None:
        """Stop the stream and release the device."""
        device, self._device = self._device, None
        if device is not None:
            with contextlib.suppress(Exception):
                self._stream.stop()

    def describe(self) -> dict[str, Any]:
        """Return sensor, serial number and encoding."""
        return self._about | self._words.describe()

    def biases(self) -> dict[str, int]:
        """Return the sensor's biases; empty where it reports none."""
        facility = self._device.get_i_ll_biases() if self._device is not None else None
        if facility is None:
            return {}
        return {str(name): int(value) for name, value in facility.get_all_biases().items()}

    def roi(self) -> list[list[int]]:
        """Return the windows that send; empty where none is set, or the library does not tell."""
        with contextlib.suppress(Exception):  # older versions lack the facility or its getters
            facility = self._device.get_i_roi()
            if facility.is_enabled():
                windows = facility.get_windows()
                return [[int(w.x), int(w.y), int(w.width), int(w.height)] for w in windows]
        return []


def _encoding(identity: Any) -> str:
    """Return the encoding of the stream, as EVT3 or ``EVT21;height=320;width=320``.

    Raises:
        DeviceError: It is one that is not read.
    """
    told = str(identity.get_current_data_encoding_format()).partition(";")[0]
    if told not in ENCODINGS:
        raise DeviceError(
            f"the camera sends {told!r}, which is not read; set it to one of {', '.join(ENCODINGS)}"
        )
    return ENCODINGS[told]
