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


class HalDevice:
    """A device of ``metavision_hal`` whose buffers a test fills."""

    def __init__(self, encoding: str) -> None:
        self.buffers: deque[Any] = deque()
        self._gone = self._started = False
        told, sensor = f"{encoding};height=320;width=320", SimpleNamespace(name="GenX320")
        self._identity = SimpleNamespace(
            get_serial=lambda: "00050123",
            get_sensor_info=lambda: sensor,
            get_current_data_encoding_format=lambda: told,
        )

    def __getattr__(self, name: str) -> Any:
        """Return what gives a facility, by its name."""
        window = SimpleNamespace(x=8, y=16, width=300, height=280)
        biases = {"bias_diff_on": 25, "bias_diff_off": 28}
        facilities = {
            "get_i_geometry": SimpleNamespace(
                get_width=lambda: SIZE[0], get_height=lambda: SIZE[1]
            ),
            "get_i_hw_identification": self._identity,
            "get_i_ll_biases": SimpleNamespace(get_all_biases=lambda: biases),
            "get_i_roi": SimpleNamespace(is_enabled=lambda: True, get_windows=lambda: [window]),
            "get_i_events_stream": self,
        }
        return lambda: facilities[name]

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
    module.DeviceDiscovery = SimpleNamespace(open=lambda serial: device)
    return module


class DriversDevice:
    """A device of ``neuromorphic_drivers`` that is given packets by a test."""

    def __init__(self) -> None:
        self._packets: deque[Any] = deque()
        self._gone = False
        self.dropped = 0

    def put(self, packet: EventPacket) -> None:
        events = np.empty(len(packet), EVENT_DTYPE)
        events["t"], events["x"], events["y"], events["p"] = (
            packet.t, packet.x, packet.y, packet.p,
        )  # fmt: skip
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
        if not self._packets:
            time.sleep(0.01)
            return SimpleNamespace(ring=None), None
        ring = SimpleNamespace(dropped_packets=self.dropped)
        return SimpleNamespace(ring=ring), self._packets.popleft()

    def __getattr__(self, name: str) -> Any:
        """Return what tells a property, by its name."""
        told = {
            "properties": SimpleNamespace(width=SIZE[0], height=SIZE[1]),
            "name": SimpleNamespace(value="Prophesee EVK4"),
            "connection": SimpleNamespace(value="USB 3.0 SuperSpeed (5.0 Gb/s)"),
            "serial": "00051505",
        }
        return lambda: told[name]


def drivers_module(device: DriversDevice) -> Any:
    """Return a module that opens the device."""
    module: Any = types.ModuleType("neuromorphic_drivers")
    module.open = lambda serial, iterator_timeout: device
    return module
