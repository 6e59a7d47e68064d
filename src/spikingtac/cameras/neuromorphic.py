"""EVK3 HD, EVK4, DVXplorer and DAVIS346 through the library ``neuromorphic-drivers``.

It does not read a GenX320: ``prophesee:``, ``openmv:``, ``v4l2:`` and ``udp:`` do.
"""

from __future__ import annotations

import contextlib
from typing import Any, ClassVar, Self

from spikingtac.cameras.libraries import require
from spikingtac.errors import CameraLostError, DeviceError
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.formats.file_source import Rows

# The library waits so long for a packet, s; it takes the time once, when the device is opened.
WAIT_S = 0.02


class NeuromorphicCamera(Camera):
    """Packets of a device of the library; its overflows are counted."""

    EXTRA: ClassVar[str] = "neuromorphic"

    def __init__(self, device: Any) -> None:
        super().__init__()
        self._device: Any = device
        properties = device.properties()
        self.size = int(properties.width), int(properties.height)
        self._dropped = 0
        self._about = {
            "model": device.name().value,
            "serial": device.serial(),
            "connection": device.connection().value,
        }

    @classmethod
    def open(cls, address: Address) -> Self:
        """Open the device of a serial number, or the first one; see :meth:`Camera.open`."""
        library = require("neuromorphic_drivers", "neuromorphic-drivers", "neuromorphic")
        serial = address.target or None
        try:
            device = library.open(serial=serial, iterator_timeout=WAIT_S)
            device.__enter__()
        except Exception as error:  # the library raises RuntimeError of many texts
            named = f"the device {serial!r}" if serial else "a device"
            raise DeviceError(
                f"neuromorphic-drivers finds no {named.partition(' ')[2]} ({error}); it reads EVK3 "
                "HD, EVK4, DVXplorer and DAVIS346, no GenX320: check the cable, and the udev rules "
                "(neuromorphic-drivers-install-udev-rules)"
            ) from error
        return cls(device)

    def read(self, timeout_s: float) -> Rows | None:
        """Return the next packet; see :meth:`Camera.read`."""
        if self._device is None:
            return None
        try:
            status, packet = next(self._device)
        except StopIteration:
            return None
        except RuntimeError as error:
            raise CameraLostError(f"{self._about['model']} is gone ({error})") from error
        if status.ring is not None:
            self.losses.add("overflow", max(status.ring.dropped_packets - self._dropped, 0))
            self._dropped = status.ring.dropped_packets
        events = None if packet is None else packet.polarity_events
        if events is None or not len(events):
            return self.nothing()
        polarity = "on" if "on" in (events.dtype.names or ()) else "p"
        return events["x"], events["y"], events[polarity], events["t"]

    def close(self) -> None:
        """Release the device."""
        device, self._device = self._device, None
        if device is not None:
            with contextlib.suppress(Exception):
                device.__exit__(None, None, None)

    def describe(self) -> dict[str, Any]:
        """Return model, serial number and connection."""
        return self._about
