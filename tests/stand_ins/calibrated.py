"""Calibrations of recordings beside the project, each computed once in a run of tests.

A corner of a recording, with sixteen of its markers, takes a half or a quarter of the time.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.open import open_events
from spikingtac.events.source import EventSource, PacketSource
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.types import EventPacket
from stand_ins.made_once import made_once


@cache
def calibrated(path: Path, size: tuple[int, int] | None = None) -> Calibration:
    """Return what a recording, or its corner, teaches, without its lag.

    Skips the test where there is no recording.
    """

    def make() -> Calibration:
        return calibrate(corner(path, size) if size else recording(path), estimate_lag=None)

    return made_once(f"calibrated_{path.parent.name}_{path.name}_{size}", make)


def recording(path: Path) -> EventSource:
    """Open a recording; skips the test where there is none."""
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the test recordings")
    return open_events(path)


def corner(path: Path, size: tuple[int, int]) -> PacketSource:
    """Return the upper left ``(width, height)`` of a recording, as if the sensor were so small."""
    return PacketSource(list(_cut(recording(path), size)), size)


def _cut(source: EventSource, size: tuple[int, int]) -> Iterator[EventPacket]:
    for packet in source:
        inside = packet.select((packet.x < size[0]) & (packet.y < size[1]))
        yield replace(inside, size=size)
