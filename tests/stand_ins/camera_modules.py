"""Modules with the documented calls of makers' libraries that need hardware; not the libraries.

``metavision_hal`` follows OpenEB's get-started sample, ``neuromorphic_drivers`` its 0.18 interface.
"""

from __future__ import annotations

import time
import types
from collections import deque
from types import SimpleNamespace
from typing import Any

import numpy as np

from spikingtac.types import EventPacket

SIZE = (320, 320)
EVENT_DTYPE = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), (("p", "on"), "?")])


def telling(**values: Any) -> SimpleNamespace:
    """Return an object whose methods return these values."""
    return SimpleNamespace(**{name: lambda value=value: value for name, value in values.items()})


class HalDevice:
    """A device of ``metavision_hal`` whose buffers a test fills."""

    def __init__(self, encoding: str) -> None:
        self.buffers: deque[Any] = deque()
        self._gone = self._started = False
        window = SimpleNamespace(x=8, y=16, width=300, height=280)
        self.facilities = telling(
            get_i_geometry=telling(get_width=SIZE[0], get_height=SIZE[1]),
            get_i_hw_identification=telling(
                get_serial="00050123",
                get_sensor_info=SimpleNamespace(name="GenX320"),
                get_current_data_encoding_format=f"{encoding};height=320;width=320",
            ),
            get_i_ll_biases=telling(get_all_biases={"bias_diff_on": 25, "bias_diff_off": 28}),
            get_i_roi=telling(is_enabled=True, get_windows=[window]),
            get_i_events_stream=self,
        )

    def unplug(self) -> None:
        self._gone = True

    def start(self) -> None:
        self._started = True

    def stop(self) -> None:
        self._started = False

    def poll_buffer(self) -> int:
        assert self._started
        return -1 if self._gone else int(len(self.buffers) > 0)

    def get_latest_raw_data(self) -> Any:
        return self.buffers.popleft()


def hal_module(device: HalDevice | None) -> Any:
    """Return a module whose discovery finds the device, or none."""
    module: Any = types.ModuleType("metavision_hal")
    found = device and device.facilities
    module.DeviceDiscovery = SimpleNamespace(open=lambda serial: found)
    return module


class DriversDevice:
    """A device of ``neuromorphic_drivers`` that is given packets by a test."""

    def __init__(self) -> None:
        self._packets: deque[Any] = deque()
        self._gone = False
        self.properties = lambda: SimpleNamespace(width=SIZE[0], height=SIZE[1])
        self.name = lambda: SimpleNamespace(value="Prophesee EVK4")
        self.connection = lambda: SimpleNamespace(value="USB 3.0 SuperSpeed (5.0 Gb/s)")
        self.serial = lambda: "00051505"

    def put(self, packet: EventPacket) -> None:
        events = np.empty(len(packet), EVENT_DTYPE)
        for name in ("t", "x", "y", "p"):
            events[name] = getattr(packet, name)
        self._packets.append(SimpleNamespace(polarity_events=events))

    def unplug(self) -> None:
        self._gone = True

    def __enter__(self) -> DriversDevice:
        return self

    def __exit__(self, *_: object) -> bool:
        return False

    def __next__(self) -> tuple[Any, Any]:
        if self._gone:
            raise RuntimeError("device disconnected")
        if self._packets:
            ring = SimpleNamespace(dropped_packets=0)
            return SimpleNamespace(ring=ring), self._packets.popleft()
        time.sleep(0.01)
        return SimpleNamespace(ring=None), None


def drivers_module(device: DriversDevice) -> Any:
    """Return a module that opens the device."""
    module: Any = types.ModuleType("neuromorphic_drivers")
    module.open = lambda serial, iterator_timeout: device
    return module
