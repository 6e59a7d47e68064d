"""Cameras of iniVation and Prophesee, through their makers' libraries and a free one.

``dv-processing`` reads DVXplorer and DAVIS, and network streams; OpenEB's hardware layer
``metavision_hal`` Prophesee's kits, whose words are decoded here, so that every encoding works that
the sensor can send; ``neuromorphic-drivers`` EVK3 HD, EVK4, DVXplorer and DAVIS346, no GenX320.
"""

import contextlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Self

import numpy as np

from spikingtac.cameras.libraries import LibraryCamera, require
from spikingtac.cameras.words import CameraWords
from spikingtac.errors import CameraLostError, DeviceError
from spikingtac.events.camera import Address
from spikingtac.events.evt.raw import RawHeader
from spikingtac.events.formats.file_source import Rows

AT_ONCE = 64  # Batches of a DVXplorer that one read takes at most; many small ones are slower.

# Names of the hardware layer -> ours.
ENCODINGS = {"EVT2": "evt2", "EVT21": "evt21", "EVT3": "evt3"}

# Sensors that send EVT2.1 as two 32-bit halves, the upper one first.
LEGACY_SENSORS = ("IMX636", "Gen41", "Gen4.1", "Gen3")

# neuromorphic-drivers waits so long for a packet, s; it takes the time when a device is opened.
WAIT_S = 0.02


class DvCamera(LibraryCamera):
    """Batches of a DVXplorer or DAVIS, or of a program that writes them to the network."""

    @classmethod
    def open(cls, address: Address) -> Self:
        """Open a camera, or connect to a network writer; see :meth:`Camera.open`."""
        library = require("dv")
        camera = cls(_reader(library, address))
        camera.about = {"model": str(camera._device.getCameraName())}
        with contextlib.suppress(AttributeError, RuntimeError):  # a network stream has none
            camera.about["serial"] = str(camera._device.getSerialNumber())
        camera.about["library"] = f"dv-processing {library.__version__}"
        if not camera._device.isEventStreamAvailable():
            raise DeviceError(f"{camera.about['model']!r} sends no events; choose its event stream")
        width, height = camera._device.getEventResolution()
        camera.size = int(width), int(height)
        return camera

    def _waiting(self) -> Rows | None:
        batches: list[Any] = []
        try:
            for _ in range(AT_ONCE):
                if (batch := self._device.getNextEventBatch()) is None:
                    break
                if not batch.isEmpty():
                    batches.append(batch)
            running = bool(batches) or self._device.isRunning()
        except RuntimeError:
            if not batches:
                raise
            running = True  # the next call says it again
        if not running:
            raise CameraLostError(
                f"{self.about['model']} is gone: unplugged, or its program has ended"
            )
        if not batches:
            return None
        events = np.concatenate([batch.numpy() for batch in batches])
        return events["x"], events["y"], events["polarity"], events["timestamp"]


def _reader(library: Any, address: Address) -> Any:
    """Return what reads a network stream, the camera of a serial number, or the first one."""
    target = address.target
    try:
        if ":" in target:
            return library.io.NetworkReader(*address.host_port("127.0.0.1"))
        if target and Path(target).exists():  # a local socket
            return library.io.NetworkReader(Path(target))
        if library.io.camera.discover():
            return library.io.camera.open(*filter(None, [target]))
    except (RuntimeError, IndexError, OSError) as error:
        why = str(error).partition(" [")[0]  # the library adds where in its sources it happened
        raise DeviceError(
            f"{str(address)!r} cannot be opened ({why}); is it there, and free?"
        ) from error
    raise DeviceError(
        "no camera of iniVation is plugged in; check cable and udev rules (spikingtac doctor), "
        "or name a network stream: dv://127.0.0.1:7777"
    )


class PropheseeCamera(LibraryCamera):
    """Raw words of a device of OpenEB."""

    checked = True

    def __init__(self, device: Any) -> None:
        super().__init__(device)
        geometry, self._stream = device.get_i_geometry(), device.get_i_events_stream()
        self.size = int(geometry.get_width()), int(geometry.get_height())
        identity = device.get_i_hw_identification()
        # As EVT3 or ``EVT21;height=320;width=320``.
        told = str(identity.get_current_data_encoding_format()).partition(";")[0]
        if told not in ENCODINGS:
            raise DeviceError(
                f"the camera sends {told!r}, which is not read; set it to one of "
                f"{', '.join(ENCODINGS)}"
            )
        sensor = str(identity.get_sensor_info().name)
        order = "legacy" if told == "EVT21" and sensor.startswith(LEGACY_SENSORS) else "little"
        words = RawHeader(encoding=ENCODINGS[told], size=self.size, byte_order=order)
        self._words = CameraWords(words, self.losses, self.triggers)
        self.about = {"model": sensor, "serial": str(identity.get_serial())}
        self.about |= self._words.describe()
        self._stream.start()

    @classmethod
    def open(cls, address: Address) -> Self:
        """Open the device of a serial number, or the first one; see :meth:`Camera.open`."""
        try:
            device = require("prophesee").DeviceDiscovery.open(address.target)
        except RuntimeError as error:
            raise DeviceError(
                f"OpenEB cannot open {address.target or 'a camera'!r} ({error}); check cable, udev "
                "rules, and that no other program has it"
            ) from error
        if device is None:
            raise DeviceError(
                "OpenEB finds no camera; check cable, power and udev rules (spikingtac doctor)"
            )
        return cls(device)

    def _waiting(self) -> Rows | None:
        found = self._stream.poll_buffer()
        if found < 0:
            raise CameraLostError(f"{self.about['model']} is gone: its stream has ended")
        data = self._stream.get_latest_raw_data() if found else None
        return None if data is None else self._words.feed(bytes(data))

    def _farewell(self, device: Any) -> Iterable[Callable[[], object]]:
        return (self._stream.stop,)

    def biases(self) -> dict[str, int]:
        """Return the sensor's biases; empty where it reports none."""
        facility = self._device.get_i_ll_biases()
        known = facility.get_all_biases() if facility is not None else {}
        return {str(name): int(value) for name, value in known.items()}

    def roi(self) -> list[list[int]]:
        """Return the windows that send; empty where none is set, or the library does not tell."""
        with contextlib.suppress(Exception):  # older versions lack the facility or its getters
            facility = self._device.get_i_roi()
            if facility.is_enabled():
                windows = facility.get_windows()
                return [[int(w.x), int(w.y), int(w.width), int(w.height)] for w in windows]
        return []


class NeuromorphicCamera(LibraryCamera):
    """Packets of a device of ``neuromorphic-drivers``; its overflows are counted."""

    POLL_S = 0.0  # the library itself waits

    def __init__(self, device: Any) -> None:
        super().__init__(device)
        properties, self._dropped = device.properties(), 0
        self.size = int(properties.width), int(properties.height)
        self.about = {
            "model": device.name().value,
            "serial": device.serial(),
            "connection": device.connection().value,
        }

    @classmethod
    def open(cls, address: Address) -> Self:
        """Open the device of a serial number, or the first one; see :meth:`Camera.open`."""
        library, serial = require("nd"), address.target or None
        try:
            device = library.open(serial=serial, iterator_timeout=WAIT_S)
            device.__enter__()
        except Exception as error:  # the library raises RuntimeError of many texts
            named = f"device {serial!r}" if serial else "device"
            raise DeviceError(
                f"neuromorphic-drivers finds no {named} ({error}); it reads EVK3 HD, EVK4, "
                "DVXplorer and DAVIS346, no GenX320: check the cable, and the udev rules "
                "(neuromorphic-drivers-install-udev-rules)"
            ) from error
        return cls(device)

    def _waiting(self) -> Rows | None:
        status, packet = next(self._device)
        if status.ring is not None:
            self.losses.add("overflow", max(status.ring.dropped_packets - self._dropped, 0))
            self._dropped = status.ring.dropped_packets
        events = None if packet is None else packet.polarity_events
        if events is None or not len(events):
            return None
        polarity = "on" if "on" in (events.dtype.names or ()) else "p"
        return events["x"], events["y"], events[polarity], events["t"]

    def _farewell(self, device: Any) -> Iterable[Callable[[], object]]:
        return (lambda: device.__exit__(None, None, None),)
