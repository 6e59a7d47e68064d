"""Recording folders: ``events.raw``, ``truth.npz`` where the truth is known, ``manifest.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from numpy.typing import NDArray

from spikingtac.atomic_files import write_text
from spikingtac.errors import RecordingError
from spikingtac.events.formats.array_file import ColumnFile, load_arrays
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.manifest import MANIFEST, SCHEMA, TRUTH, name_of, read_manifest
from spikingtac.types import EventPacket, LossCounters


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
        if not (folder / "events.raw").is_file():
            raise RecordingError(
                f"{str(path)!r} is no recording folder: it holds no events.raw; "
                "open a single file with open_events"
            )
        return cls(folder, read_manifest(folder / MANIFEST))

    @property
    def sensors(self) -> int:
        """Number of sensors on the folder's clock."""
        count = 1
        while (self.path / f"events_{count}.raw").is_file():
            count += 1
        return count

    def events(self, sensor: int = 0, *, strict: bool = False) -> FileSource:
        """Return the events of one sensor."""
        from spikingtac.events.open import open_events

        return open_events(self.path, sensor=sensor, strict=strict)

    def truth(self) -> dict[str, NDArray[Any]] | None:
        """Return the arrays of ``truth.npz``, or None where the truth is not known.

        Raises:
            RecordingError: The file is there but cannot be read.
        """
        if not (self.path / TRUTH).is_file():
            return None
        return load_arrays(self.path / TRUTH, "ground truth")


class RecordingWriter:
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
        (self.path / MANIFEST).unlink(missing_ok=True)
        (self.path / TRUTH).unlink(missing_ok=True)
        names = [name_of("events.raw", index) for index in range(sensors)]
        self._writers = [RawWriter(self.path / name, size, in_place=True) for name in names]
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

    def append_truth(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append rows to the growing arrays of the truth, e.g. ``marker_t_us``, ``marker_px``."""
        self._truth_file().append(columns)

    def set_truth(self, name: str, values: NDArray[Any]) -> None:
        """Set an array of the truth that does not grow, e.g. ``reference_px``."""
        self._truth_file().set(name, values)

    def describe(self, **fields: Any) -> None:
        """Add fields to the manifest: seed, scene and its sha256, contrast, thresholds ..."""
        self._fields.update(fields)

    def close(self) -> None:
        """Complete the folder; further calls do nothing."""
        if self._closed:
            return
        self._close_files()
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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None:
            self.close()
        else:
            self._close_files()

    def _close_files(self) -> None:
        self._closed = True
        for writer in self._writers:
            writer.close()
        if self._truth is not None:
            self._truth.close()

    def _truth_file(self) -> ColumnFile:
        self._truth = self._truth or ColumnFile(self.path / TRUTH)
        return self._truth
