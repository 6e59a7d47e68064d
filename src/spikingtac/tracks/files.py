"""Write tracks: ``tracks.npz``, and its twins in long form, CSV and Parquet."""

from __future__ import annotations

import csv
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import WholeFile, write_text
from spikingtac.errors import ConfigError, MissingExtraError
from spikingtac.events.formats.array_file import ColumnFile
from spikingtac.tracks.columns import Columns, long_columns, stacked, trigger_column
from spikingtac.types import MarkerFrame

# Key of a Parquet file's metadata that holds what CSV has beside it, as JSON.
PARQUET_META = "spikingtac"
FRAMES_PER_CHUNK = 1_024  # Frames that are kept in memory before they are written.


class TracksWriter(ABC):
    """Takes frames one by one, and writes them at constant memory.

    Args:
        markers: How many markers each frame has.
    """

    marks_rows = True
    """Whether trigger edges mark the rows, and must be told before them."""

    def __init__(self, markers: int) -> None:
        self._markers = markers
        self._frames: list[tuple[MarkerFrame, Columns]] = []
        self._triggers: Columns = {}
        self._last_us: int | None = None

    def write(self, frame: MarkerFrame, measured: Columns | None = None) -> None:
        """Append a frame, and what else was measured then: the same names with every frame."""
        self._frames.append((frame, measured or {}))
        if len(self._frames) == FRAMES_PER_CHUNK:
            self._flush()

    def mark(self, triggers: Columns) -> None:
        """Tell the trigger edges by their keys in a file: where rows are marked, first."""
        self._triggers = triggers

    def close(self, meta: Mapping[str, Any]) -> None:
        """Complete the file with what is known at the end; only then it appears."""
        self._flush()
        self._complete(meta)

    @abstractmethod
    def abandon(self) -> None:
        """Give up: leave what was there before."""

    @abstractmethod
    def _append(self, columns: dict[str, NDArray[Any]]) -> None:
        """Write the columns of some frames."""

    @abstractmethod
    def _complete(self, meta: Mapping[str, Any]) -> None:
        """Write the meta data, and put the file in its place."""

    def _flush(self) -> None:
        if not self._frames:
            return
        frames, measured = zip(*self._frames, strict=True)
        self._frames = []
        columns = stacked(frames, self._markers)
        for name in measured[0]:
            columns[name] = np.stack([row[name] for row in measured]).astype(np.float32)
        if self.marks_rows:
            columns |= trigger_column(columns["t_us"], self._triggers, self._last_us)
        self._append(columns)
        self._last_us = frames[-1].t_us


class NpzTracksWriter(TracksWriter):
    """Writes ``tracks.npz``; equal frames give equal bytes."""

    marks_rows = False

    def __init__(self, path: Path, reference_px: NDArray[np.float64]) -> None:
        super().__init__(len(reference_px))
        self._file = ColumnFile(path)
        self._file.set("reference_px", reference_px.astype(np.float32))
        self._append(stacked([], self._markers))  # an archive without estimates has them, too

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._file.abandon()

    def _append(self, columns: dict[str, NDArray[Any]]) -> None:
        self._file.append(columns)

    def _complete(self, meta: Mapping[str, Any]) -> None:
        for name, values in self._triggers.items():
            self._file.set(name, values)
        self._file.set("meta", np.array(json.dumps(meta, sort_keys=True)))
        self._file.close()


class CsvTracksWriter(TracksWriter):
    """Writes one line per time and marker, and the meta data beside it, into ``NAME.csv.json``."""

    def __init__(self, path: Path, markers: int) -> None:
        super().__init__(markers)
        self._target = WholeFile(path)
        self._file: IO[str] = self._target.open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._begun = False

    def _append(self, columns: dict[str, NDArray[Any]]) -> None:
        rows = long_columns(columns)
        if not self._begun:
            self._rows.writerow(rows)
            self._begun = True
        self._rows.writerows(zip(*(_texts(*item) for item in rows.items()), strict=True))

    def _complete(self, meta: Mapping[str, Any]) -> None:
        if not self._begun:  # no frame came
            self._append(stacked([], self._markers))
        path = self._target.path
        text = json.dumps(meta, indent=1, sort_keys=True) + "\n"
        write_text(path.with_name(path.name + ".json"), text)
        self._target.commit(self._file)

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._target.abandon(self._file)


def _texts(name: str, values: NDArray[Any]) -> list[Any]:
    if name == "held":
        return values.astype(int).tolist()
    if values.dtype.kind != "f":
        return values.tolist()
    form = "{:.3f}" if name == "confidence" else "{:z.4f}"  # z writes no -0.0000
    return [form.format(value) for value in values.tolist()]


class ParquetTracksWriter(TracksWriter):
    """Writes the columns of the CSV file, with their types: for pandas, Polars, R and DuckDB.

    Raises:
        MissingExtraError: pyarrow is not installed.
    """

    def __init__(self, path: Path, markers: int) -> None:
        super().__init__(markers)
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError as error:
            raise MissingExtraError(
                "Parquet needs pyarrow; install it with: pip install 'spikingtac[parquet]'"
            ) from error
        self._arrow, self._target = pyarrow, WholeFile(path)
        self._file: Any = None

    def _append(self, columns: dict[str, NDArray[Any]]) -> None:
        rows = long_columns(columns)
        rows["marker"] = rows["marker"].astype(np.int16)
        table = self._arrow.table(rows)
        if self._file is None:
            # Neighbours in a float column share their high bytes, and hardly any value repeats.
            self._file = self._arrow.parquet.ParquetWriter(
                self._target.partial,
                table.schema,
                compression="zstd",
                use_dictionary=["t_us", "marker"],
                use_byte_stream_split=[name for name in rows if rows[name].dtype.kind == "f"],
            )
        self._file.write_table(table)

    def _complete(self, meta: Mapping[str, Any]) -> None:
        if self._file is None:  # no frame came
            self._append(stacked([], self._markers))
        assert self._file is not None  # _append() opened it
        self._file.add_key_value_metadata({PARQUET_META: json.dumps(meta, sort_keys=True)})
        self._file.close()
        self._target.commit()

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        if self._file is not None:
            self._file.close()
        self._target.abandon()


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
        return CsvTracksWriter(target, len(reference_px))
    if target.suffix == ".parquet":
        return ParquetTracksWriter(target, len(reference_px))
    raise ConfigError(f"tracks are written as .npz, .csv or .parquet, not as {target.name!r}")
