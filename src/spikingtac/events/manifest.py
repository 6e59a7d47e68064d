"""Manifests of recording folders, their clocks, and events and poses on another clock."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.clock import US_PER_S, TimeMap
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows

SCHEMA = 1  # Version of the manifest that this package writes and reads.

MANIFEST, TRUTH = "manifest.json", "truth.npz"

# What the times of poses are: time of day, the host's monotonic clock, or the sensor's own; auto
# tells the first two by their size.
PoseClock = Literal["auto", "unix", "monotonic", "sensor"]

# Times from here on are times of day, s: monotonic clocks begin with their host.
UNIX_LEAST_S = 1e9

# Name of a time column -> its unit, us.
TIME_COLUMNS = {"t_us": 1.0, "t_ns": 1e-3, "t_ms": 1e3, "t_s": US_PER_S, "timestamp": US_PER_S}

# Hosts whose monotonic clocks began within this time are one host, s (setting the time of
# day moves it by less, a start takes longer).
SAME_START_S = 5.0


def name_of(first: str, sensor: int) -> str:
    """Return the name of a sensor's file: ``events.raw`` of the second sensor is ``events_1.raw``.

    Args:
        first: Name of the first sensor's.
        sensor: Which one, from 0 on.
    """
    stem, dot, ending = first.rpartition(".")
    return first if sensor == 0 else f"{stem}_{sensor}{dot}{ending}"


def read_manifest(path: Path) -> dict[str, Any]:
    """Return a manifest; empty where there is none.

    Raises:
        RecordingError: It is damaged, or of a newer schema.
    """
    if not path.is_file():
        return {}
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RecordingError(f"{str(path)!r} cannot be read: {error}") from error
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        found = manifest.get("schema") if isinstance(manifest, dict) else None
        raise RecordingError(
            f"{str(path)!r} has schema {found!r}, this version reads {SCHEMA}; "
            "update the package, or remove the manifest to read the events alone"
        )
    return manifest


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
        self._source, self._map, self._named_size = source, time_map, source.size
        self.checked, self.format = source.checked, source.format
        super().__init__(source.path, options)
        self.notes = [*source.notes]
        if isinstance(time_map, TimeMap):
            self.notes.append(
                f"times are on the first sensor's clock (drift {time_map.drift_ppm:.1f} ppm, "
                f"error {time_map.error_us:.0f} us, learned from {time_map.learned_from})"
            )

    def _columns(self) -> Iterator[Rows]:
        self._source.losses, self._source.triggers = self.losses, Triggers()
        for x, y, p, own_us in self._source.columns():
            self.progress = self._source.progress
            t = self._map(np.asarray(own_us))
            first = int(np.searchsorted(t, 0))  # t is in order
            self.losses.add("before_zero", first)
            self._place_triggers()
            yield x[first:], y[first:], p[first:], t[first:]
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


@dataclass(frozen=True)
class Poses:
    """A robot's poses over time.

    Attributes:
        t_us: ``(n,)`` int64 times, us, in order.
        state: ``(n, k)`` values.
        names: Names of the k columns.
    """

    t_us: NDArray[np.int64]
    state: NDArray[np.float64]
    names: tuple[str, ...]

    def on(self, time_map: TimeMap) -> Poses:
        """Return the same poses with their times on another clock."""
        return replace(self, t_us=time_map(self.t_us))

    def save(self, path: Path) -> None:
        """Write ``.npz`` with ``t_us``, ``state`` and ``names``; ``export --log`` takes it."""
        with replacing(path) as whole, whole.open("wb") as file:
            np.savez(file, t_us=self.t_us, state=self.state, names=np.array(self.names))


def load_poses(path: Path) -> Poses:
    """Read a CSV with a header: one time column (``t_us``, ``t_s`` ...), and columns of numbers.

    Raises:
        RecordingError: It cannot be read as that.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if row]
        names = [name.strip() for name in rows[0]]
        values = np.array([[float(cell) for cell in row] for row in rows[1:]])
        (column,) = (number for number, name in enumerate(names) if name in TIME_COLUMNS)
        if values.ndim != 2 or values.shape[1] != len(names) or not np.isfinite(values).all():
            raise ValueError("a row is short, or holds no finite number")
        t_us = np.rint(values[:, column] * TIME_COLUMNS[names[column]]).astype(np.int64)
        if (np.diff(t_us) < 0).any():
            raise ValueError("its times run backwards; sort the rows")
    except (OSError, ValueError, IndexError, csv.Error) as error:
        raise RecordingError(
            f"{str(path)!r} is no table of poses: {error}; it needs a header with one time column "
            f"({', '.join(TIME_COLUMNS)}) and columns of numbers, such as x_mm,y_mm,z_mm"
        ) from error
    names.pop(column)
    return Poses(t_us, np.delete(values, column, axis=1), tuple(names))


def map_of_poses(poses: Poses, recording: Path, clock: PoseClock) -> tuple[TimeMap, PoseClock]:
    """Return the map from the poses' clock to the recording's, and which clock theirs is.

    Raises:
        ConfigError: The host's clock is meant, and the recording does not know it.
    """
    unix = poses.t_us[0] / US_PER_S > UNIX_LEAST_S
    chosen: PoseClock = ("unix" if unix else "monotonic") if clock == "auto" else clock
    if chosen == "sensor":
        return TimeMap(learned_from="given"), chosen
    known = clock_beside(recording)
    if known is None:
        raise ConfigError(
            f"{str(recording)!r} does not know its host's clock, as a recording of spikingtac "
            "record does; where the poses are on the sensor's own, say --poses-clock sensor"
        )
    shift_s = known.unix_minus_monotonic_s if chosen == "unix" else 0.0
    found = known.mapping.inverse()
    return replace(found, own_us=found.own_us + shift_s * US_PER_S), chosen
