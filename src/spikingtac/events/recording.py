"""Recording folders: ``events.raw``, ``truth.npz`` where the truth is known, ``manifest.json``.

A manifest may know the sensor's clock, by which events are put on the clock of another sensor.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import write_text
from spikingtac.errors import RecordingError
from spikingtac.events.clock import TimeMap
from spikingtac.events.formats.array_file import ColumnFile, load_truth
from spikingtac.events.formats.codec import Triggers, WrittenWhole
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.file_kinds import RECORDING_NAME
from spikingtac.types import EventPacket, LossCounters

SCHEMA = 1  # Version of the manifest that this package writes and reads.
MANIFEST, TRUTH = "manifest.json", "truth.npz"

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
    found = manifest.get("schema") if isinstance(manifest, dict) else None
    if found != SCHEMA:
        raise RecordingError(
            f"{str(path)!r} has schema {found!r}, this version reads {SCHEMA}; "
            "update the package, or remove the manifest to read the events alone"
        )
    return manifest


class RecordedClock(NamedTuple):
    """A sensor's clock as a recording knows it.

    Attributes:
        mapping: The clock on the host's monotonic one.
        unix_minus_monotonic_s: What turns that into the time of day, s.
    """

    mapping: TimeMap
    unix_minus_monotonic_s: float

    @classmethod
    def beside(cls, path: Path, sensor: int = 0) -> Self | None:
        """Return the clock of a recording folder, or of a file in one.

        Returns:
            None of a simulation or a converted file, which know no clock.

        Raises:
            RecordingError: Its manifest is damaged.
        """
        folder = path if path.is_dir() else path.parent
        manifest = read_manifest(folder / name_of(MANIFEST, sensor))
        try:
            offset_s = float(manifest["host"]["unix_minus_monotonic_s"])
            return cls(TimeMap.from_clock(manifest["clock"]), offset_s)
        except (TypeError, KeyError, ValueError):
            return None

    def on(self, base: Self | None) -> TimeMap | None:
        """Return the map to another clock, or None where they were not watched by one host."""
        if base is None:
            return None
        apart_s = self.unix_minus_monotonic_s - base.unix_minus_monotonic_s
        return self.mapping.then(base.mapping.inverse()) if abs(apart_s) < SAME_START_S else None


def time_base_of(folder: Path, sensor: int) -> TimeMap | None:
    """Return the map from a sensor's clock to that of the folder's first one.

    None where the files are on one clock already, as those of a simulation are.
    """
    if sensor == 0:
        return None
    manifest = read_manifest(folder / name_of(MANIFEST, sensor))
    if "time_base" in manifest:
        return TimeMap.from_document(manifest["time_base"])
    own = RecordedClock.beside(folder, sensor)  # of a recorder that was killed
    return None if own is None else own.on(RecordedClock.beside(folder))


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

    def close(self) -> None:
        """End the iteration of a camera soon."""
        getattr(self._source, "close", lambda: None)()

    def _columns(self) -> Iterator[Rows]:
        self._source.losses, self._source.triggers = self.losses, Triggers()
        self._edges_placed = 0
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
        # The source keeps them: who shares its events tells which edges are new by their number.
        edges = self._source.triggers.select(slice(self._edges_placed, None))
        if len(edges):
            self.triggers.append(self._map(edges.t_us), edges.channel, edges.edge)
            self._edges_placed += len(edges)


@dataclass(frozen=True)
class Recording:
    """A recording folder that was opened.

    Attributes:
        path: The folder.
        manifest: What its manifest says; empty where there is none.
    """

    path: Path
    manifest: dict[str, Any]

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a folder; one without a manifest is accepted.

        Raises:
            RecordingError: It is no folder with ``events.raw``, or its manifest is damaged or of a
                newer schema.
        """
        folder = Path(path)
        if not (folder / RECORDING_NAME).is_file():
            raise RecordingError(
                f"{str(path)!r} is no recording folder: it holds no events.raw; "
                "open a single file with open_events"
            )
        return cls(folder, read_manifest(folder / MANIFEST))

    def events(self, sensor: int = 0, *, strict: bool = False) -> FileSource:
        """Return the events of one sensor."""
        from spikingtac.events import open_events

        return open_events(self.path, sensor=sensor, strict=strict)

    def truth(self) -> dict[str, NDArray[Any]] | None:
        """Return the arrays of ``truth.npz``, or None where the truth is not known.

        Raises:
            RecordingError: See :func:`load_truth`.
        """
        path = self.path / TRUTH
        return load_truth(path) if path.is_file() else None


class RecordingWriter(WrittenWhole):
    """Writes a recording folder packet by packet; the same input gives the same bytes.

    What was received stays readable whatever happens; the manifest comes last, so that a folder
    without one was not completed.

    Args:
        path: Folder to create; its files are replaced if they exist.
        size: ``(width, height)`` of the sensors, px.
        sensors: Number of sensors on one clock.
    """

    def __init__(self, path: str | Path, size: tuple[int, int], sensors: int = 1) -> None:
        from spikingtac.events.evt.raw_writer import RawWriter

        self.path = Path(path)
        self.path.mkdir(parents=True, exist_ok=True)
        self.losses = LossCounters()
        for name in (MANIFEST, TRUTH):
            (self.path / name).unlink(missing_ok=True)
        paths = [self.path / name_of(RECORDING_NAME, index) for index in range(sensors)]
        self._writers = [RawWriter(file, size, in_place=True) for file in paths]
        self._size, self._closed = size, False
        self._truth: ColumnFile | None = None
        self._fields: dict[str, Any] = {}
        self._start_us: int | None = None
        self._end_us = 0

    def write(self, packet: EventPacket, sensor: int = 0) -> None:
        """Append a packet of one sensor."""
        self._writers[sensor].write(packet)
        start_us = packet.t_start_us
        self._start_us = start_us if self._start_us is None else min(self._start_us, start_us)
        self._end_us = max(self._end_us, packet.t_end_us)

    def pass_triggers(self, triggers: Triggers, passed: int, sensor: int = 0) -> int:
        """Append the trigger edges of a sensor from a number on; return how many there are."""
        self._writers[sensor].add_triggers(triggers.select(slice(passed, None)))
        return len(triggers)

    def describe(self, **fields: Any) -> None:
        """Add fields to the manifest: seed, scene and its sha256, contrast, thresholds ..."""
        self._fields.update(fields)

    def close(self) -> None:
        """Complete the folder; further calls do nothing."""
        if self._closed:
            return
        self.abandon()  # all files are closed; what follows completes the folder
        from spikingtac._version import package_version

        manifest = {
            "schema": SCHEMA,
            "size": list(self._size),
            "sensors": len(self._writers),
            "t_start_us": self._start_us or 0,
            "t_end_us": self._end_us,
            "package_version": package_version(),
            "losses": dict(self.losses.kinds()),
            **self._fields,
        }
        text = json.dumps(manifest, indent=1, sort_keys=True, allow_nan=False) + "\n"
        write_text(self.path / MANIFEST, text)

    def abandon(self) -> None:
        """End without a manifest; what was received stays readable."""
        self._closed = True
        for file in (*self._writers, self._truth):
            if file is not None:
                file.close()

    def truth_file(self) -> ColumnFile:
        """Return ``truth.npz``: arrays that grow, as ``marker_px``, and ``reference_px``."""
        self._truth = self._truth or ColumnFile(self.path / TRUTH)
        return self._truth
