"""The clocks that recordings of cameras know: each manifest maps its sensor's to the host's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikingtac.events.cameras.clock import ClockMapping
from spikingtac.events.clocks.time_map import TimeMap, through_host
from spikingtac.events.manifest import MANIFEST, name_of, read_manifest

SAME_START_S = 5.0
"""Hosts whose monotonic clocks began within this time are one host, s (ours: setting the time of
day moves it by less, a start takes longer)."""


@dataclass(frozen=True, slots=True)
class RecordedClock:
    """A sensor's clock as a recording knows it.

    Attributes:
        mapping: The clock on the host's monotonic one.
        unix_minus_monotonic_s: What turns that into the time of day, s.
    """

    mapping: ClockMapping
    unix_minus_monotonic_s: float

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> RecordedClock | None:
        """Return the clock of a manifest; None of a simulation or a converted file."""
        clock, host = manifest.get("clock"), manifest.get("host")
        if not isinstance(clock, dict) or not isinstance(host, dict):
            return None
        try:
            return cls(ClockMapping(**clock), float(host["unix_minus_monotonic_s"]))
        except (TypeError, KeyError, ValueError):
            return None

    def on(self, base: RecordedClock) -> TimeMap | None:
        """Return the map to another clock, or None where they were not watched by one host."""
        apart_s = self.unix_minus_monotonic_s - base.unix_minus_monotonic_s
        return through_host(self.mapping, base.mapping) if abs(apart_s) < SAME_START_S else None


def clock_beside(path: Path) -> RecordedClock | None:
    """Return the clock of a recording folder, or of a file in one; None where it knows none.

    Raises:
        RecordingError: Its manifest is damaged.
    """
    folder = path if path.is_dir() else path.parent
    return RecordedClock.of(read_manifest(folder / MANIFEST))


def time_base_of(folder: Path, sensor: int) -> TimeMap | None:
    """Return the map from a sensor's clock to that of the folder's first one.

    Returns:
        None where the files are on one clock already, as those of a simulation are.

    Raises:
        RecordingError: A manifest is damaged.
    """
    path = folder / name_of(MANIFEST, sensor)
    if sensor == 0 or not path.is_file():
        return None
    manifest = read_manifest(path)
    if "time_base" in manifest:
        return TimeMap.from_document(manifest["time_base"])
    own, base = RecordedClock.of(manifest), clock_beside(folder)  # of a recorder that was killed
    return None if own is None or base is None else own.on(base)
