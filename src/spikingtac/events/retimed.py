"""Recordings on one clock: what their manifests know, and the events of one on another's clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.clock import TimeMap
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.events.manifest import MANIFEST, name_of, read_manifest

# Hosts whose monotonic clocks began within this time are one host, s (ours: setting the time of
# day moves it by less, a start takes longer).
SAME_START_S = 5.0


@dataclass(frozen=True, slots=True)
class RecordedClock:
    """A sensor's clock as a recording knows it.

    Attributes:
        mapping: The clock on the host's monotonic one.
        unix_minus_monotonic_s: What turns that into the time of day, s.
    """

    mapping: TimeMap
    unix_minus_monotonic_s: float

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> RecordedClock | None:
        """Return the clock of a manifest; None of a simulation or a converted file."""
        clock, host = manifest.get("clock"), manifest.get("host")
        if not isinstance(clock, dict) or not isinstance(host, dict):
            return None
        try:
            return cls(TimeMap.from_clock(clock), float(host["unix_minus_monotonic_s"]))
        except (TypeError, KeyError, ValueError):
            return None

    def on(self, base: RecordedClock) -> TimeMap | None:
        """Return the map to another clock, or None where they were not watched by one host."""
        apart_s = self.unix_minus_monotonic_s - base.unix_minus_monotonic_s
        return self.mapping.then(base.mapping.inverse()) if abs(apart_s) < SAME_START_S else None


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


class RetimedSource(FileSource):
    """The events of a source with their times on the clock of another one.

    Events from before that clock's zero have no time on it: they are dropped and counted as
    ``before_zero``.

    Args:
        source: The events.
        time_map: From its clock to the other one; keeps what is in order so.
        options: As of the source.
    """

    def __init__(
        self,
        source: FileSource,
        time_map: Callable[[NDArray[np.integer[Any]]], NDArray[np.int64]],
        options: ReadOptions,
    ) -> None:
        self._source, self._map = source, time_map
        self.checked = source.checked
        super().__init__(source.path, options)
        self.format = source.format
        self.notes = [*source.notes]
        if isinstance(time_map, TimeMap):
            self.notes.append(
                f"times are on the first sensor's clock (drift {time_map.drift_ppm:.1f} ppm, "
                f"error {time_map.error_us:.0f} us, learned from {time_map.learned_from})"
            )

    def _size(self) -> tuple[int, int]:
        return self._source.size

    def _columns(self) -> Iterator[Rows]:
        self._source.losses, self._source.triggers = self.losses, Triggers()
        for x, y, p, own_us in self._source.columns():
            self.progress = self._source.progress
            t = self._map(np.asarray(own_us))
            if len(t) and t[0] < 0:
                keep = t >= 0
                self.losses.add("before_zero", int(len(t) - np.count_nonzero(keep)))
                x, y, p, t = x[keep], y[keep], p[keep], t[keep]
            self._place_triggers()
            yield x, y, p, t
        self._place_triggers()

    def _place_triggers(self) -> None:
        """Put the trigger edges met so far on the other clock, too."""
        edges = self._source.triggers
        if len(edges):
            self.triggers.append(self._map(edges.t_us), edges.channel, edges.edge)
            edges.clear()


def is_same_folder(first: Path, second: Path) -> bool:
    """Return whether two paths are one folder: then its second sensor is meant."""
    return first.is_dir() and second.is_dir() and first.samefile(second)
