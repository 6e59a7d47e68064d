"""Write tracks: ``tracks.npz``, and its CSV twin in long form."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import WholeFile, write_text
from spikingtac.errors import ConfigError
from spikingtac.events.formats.array_file import ColumnFile
from spikingtac.types import MarkerFrame

FRAMES_PER_CHUNK = 1_024
"""Frames that are kept in memory before they are written."""

CSV_COLUMNS = (
    "t_us",
    "marker",
    "detected_x_px",
    "detected_y_px",
    "position_x_px",
    "position_y_px",
    "displacement_x_px",
    "displacement_y_px",
    "held",
    "confidence",
)


FIELDS = {"held": "coasted"}
"""Key of a file -> the attribute that holds it, where the two differ."""

COLUMN_TYPES = {
    "detected_px": np.float32,
    "position_px": np.float32,
    "displacement_px": np.float32,
    "held": np.bool_,
    "confidence": np.float32,
}
"""Key of a file -> the type of its numbers."""

HEALTH_TYPES = {
    "gaps": np.int32,
    "overflows": np.int32,
    "damaged": np.int32,
    "reconnects": np.int32,
    "rate_ev_s": np.float32,
}
"""Key of a file -> the type of a counter of the source, one a time; older files lack them."""


class TracksWriter(Protocol):
    """Takes frames one by one and writes them somewhere."""

    def write(self, frame: MarkerFrame) -> None:
        """Append a frame."""
        ...

    def close(self, meta: Mapping[str, Any]) -> None:
        """Complete the file with what is known at the end; only then it appears."""
        ...

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        ...


def create_tracks(path: str | Path, reference_px: NDArray[np.float64]) -> TracksWriter:
    """Return a writer by the file's ending: ``.npz``, or ``.csv`` in long form.

    Raises:
        ConfigError: The ending is neither, or the folder does not exist.
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise ConfigError(f"the folder {str(target.parent)!r} does not exist; create it first")
    if target.suffix == ".npz":
        return NpzTracksWriter(target, reference_px)
    if target.suffix == ".csv":
        return CsvTracksWriter(target)
    raise ConfigError(f"tracks are written as .npz or .csv, not as {target.name!r}")


class NpzTracksWriter:
    """Writes ``tracks.npz`` at constant memory; equal frames give equal bytes."""

    def __init__(self, path: Path, reference_px: NDArray[np.float64]) -> None:
        self._file = ColumnFile(path)
        self._file.set("reference_px", reference_px.astype(np.float32))
        self._frames: list[MarkerFrame] = []
        self._measured: list[Mapping[str, NDArray[np.float64]]] = []
        self._flush_empty(len(reference_px))

    def write(self, frame: MarkerFrame) -> None:
        """Append a frame."""
        self._frames.append(frame)
        if len(self._frames) == FRAMES_PER_CHUNK:
            self._flush()

    def measure(self, columns: Mapping[str, NDArray[np.float64]]) -> None:
        """Add what was measured in the next frame: the same names with every frame, or never."""
        self._measured.append(columns)

    def close(self, meta: Mapping[str, Any]) -> None:
        """Complete the file with what is known at the end."""
        self._flush()
        self._file.set("meta", np.array(json.dumps(meta, sort_keys=True)))
        self._file.close()

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._file.abandon()

    def _flush(self) -> None:
        if not self._frames:
            return
        frames, self._frames = self._frames, []
        columns = {
            name: np.stack([getattr(frame, FIELDS.get(name, name)) for frame in frames]).astype(
                dtype
            )
            for name, dtype in COLUMN_TYPES.items()
        }
        for name, dtype in HEALTH_TYPES.items():
            columns[name] = np.array([getattr(frame.health, name) for frame in frames], dtype)
        measured, self._measured = self._measured, []
        for name in measured[0] if measured else ():
            columns[name] = np.stack([row[name] for row in measured]).astype(np.float32)
        self._file.append({"t_us": np.array([frame.t_us for frame in frames]), **columns})

    def _flush_empty(self, markers: int) -> None:
        shapes = {"held": (0, markers), "confidence": (0, markers)}
        columns = {
            name: np.empty(shapes.get(name, (0, markers, 2)), dtype)
            for name, dtype in COLUMN_TYPES.items()
        }
        counters = {name: np.empty(0, dtype) for name, dtype in HEALTH_TYPES.items()}
        self._file.append({"t_us": np.empty(0, np.int64), **columns, **counters})


class CsvTracksWriter:
    """Writes one line per time and marker."""

    def __init__(self, path: Path) -> None:
        self._target = WholeFile(path)
        self._file: IO[str] = self._target.open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._rows.writerow(CSV_COLUMNS)

    def write(self, frame: MarkerFrame) -> None:
        """Append a frame."""
        vectors = np.column_stack([frame.detected_px, frame.position_px, frame.displacement_px])
        for marker, vector in enumerate(vectors):
            self._rows.writerow(
                [
                    frame.t_us,
                    marker,
                    *(f"{value:z.4f}" for value in vector),  # z writes no -0.0000
                    int(frame.coasted[marker]),
                    f"{frame.confidence[marker]:.3f}",
                ]
            )

    def close(self, meta: Mapping[str, Any]) -> None:
        """Complete the file; the meta data go beside it, into ``NAME.csv.json``."""
        path = self._target.path
        text = json.dumps(meta, indent=1, sort_keys=True) + "\n"
        write_text(path.with_name(path.name + ".json"), text)
        self._target.commit(self._file)

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._target.abandon(self._file)
