"""Write tracks: ``tracks.npz``, and its twins in long form, CSV and Parquet."""

from __future__ import annotations

import csv
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import WholeFile, write_text
from spikingtac.errors import ConfigError
from spikingtac.events.formats.array_file import ColumnFile
from spikingtac.tracks.columns import CSV_COLUMNS, stacked
from spikingtac.types import MarkerFrame

FRAMES_PER_CHUNK = 1_024
"""Frames that are kept in memory before they are written."""


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
    """Return a writer by the file's ending: ``.npz``, or ``.csv`` and ``.parquet`` in long form.

    Raises:
        ConfigError: The ending is none of these, or the folder does not exist.
        MissingExtraError: ``.parquet`` needs the extra ``[parquet]``.
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise ConfigError(f"the folder {str(target.parent)!r} does not exist; create it first")
    if target.suffix == ".npz":
        return NpzTracksWriter(target, reference_px)
    if target.suffix == ".csv":
        return CsvTracksWriter(target)
    if target.suffix == ".parquet":
        from spikingtac.tracks.parquet import ParquetTracksWriter

        return ParquetTracksWriter(target)
    raise ConfigError(f"tracks are written as .npz, .csv or .parquet, not as {target.name!r}")


def is_tracks_file(path: str | Path) -> bool:
    """Return whether a file is an archive that holds displacements over time."""
    if Path(path).suffix != ".npz" or not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return {"t_us.npy", "displacement_px.npy"} <= set(archive.namelist())


class NpzTracksWriter:
    """Writes ``tracks.npz`` at constant memory; equal frames give equal bytes."""

    def __init__(self, path: Path, reference_px: NDArray[np.float64]) -> None:
        self._file = ColumnFile(path)
        self._file.set("reference_px", reference_px.astype(np.float32))
        self._frames: list[MarkerFrame] = []
        self._measured: list[Mapping[str, NDArray[np.float64]]] = []
        self._markers = len(reference_px)
        self._file.append(stacked([], self._markers))  # an archive without estimates has them, too

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
        columns = stacked(frames, self._markers)
        measured, self._measured = self._measured, []
        for name in measured[0] if measured else ():
            columns[name] = np.stack([row[name] for row in measured]).astype(np.float32)
        self._file.append(columns)


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
