"""Tracks on disk: the columns of ``tracks.npz``, and those in long form of CSV and Parquet.

Archives hold one row for each time, tables one for each time and marker.
"""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import WholeFile, require_free, write_text
from spikingtac.errors import import_extra
from spikingtac.events.formats.array_file import ColumnFile, Specs
from spikingtac.events.formats.codec import TRIGGERS, WrittenWhole
from spikingtac.types import FloatArray, MarkerFrame

Columns = Mapping[str, NDArray[Any]]  # Key of a file -> values.

VECTORS = ("detected_px", "position_px", "displacement_px")  # Those that have an x and a y.
PER_MARKER = (*VECTORS, "held", "confidence")
HEALTH = ("gaps", "overflows", "damaged", "reconnects", "rate_ev_s")  # Older files lack them.
FORCES = ("force_n", "force_sigma_n", "torque_nm")  # Where a model estimated them.

SIGMA = "sigma_px"  # Key of the places' standard deviation: where tracks were smoothed.

# Key of a file -> type of its numbers, and shape: n times, m markers, k trigger edges.
SPECS: Specs = {
    "t_us": (np.int64, "n"),
    "reference_px": (np.float32, "m2"),
    **dict.fromkeys(VECTORS, (np.float32, "nm2")),
    "held": (np.bool_, "nm"),
    "confidence": (np.float32, "nm"),
    **dict.fromkeys(HEALTH[:4], (np.int32, "n")),
    "rate_ev_s": (np.float32, "n"),
    **dict.fromkeys(FORCES, (np.float32, "n3")),
    SIGMA: (np.float32, "nm2"),
    **dict(zip(TRIGGERS, ((np.int64, "k"), (np.uint8, "k"), (np.bool_, "k")), strict=True)),
}
NEEDED = ("t_us", "reference_px", *PER_MARKER)  # Keys that every file of tracks has.

PARQUET_META = "spikingtac"  # Key of a Parquet file's metadata: as JSON what CSV has beside it.
FRAMES_PER_CHUNK = 1_024  # Frames that are kept in memory before they are written.
ATTRIBUTES = {"held": "coasted"}  # Key of a file -> the attribute that holds it, where they differ.


def stacked(frames: Sequence[MarkerFrame], markers: int) -> dict[str, NDArray[Any]]:
    """Return the values of frames by their keys in a file: ``t_us (n,)``, then ``(n, m, ...)``.

    Args:
        frames: Any number, also none.
        markers: How many markers each has.
    """
    sizes, columns = {"n": len(frames), "m": markers, "2": 2}, {}
    for name in ("t_us", *PER_MARKER, *HEALTH):
        dtype, letters = SPECS[name]
        attribute = ATTRIBUTES.get(name, name)
        rows = [getattr(one.health if name in HEALTH else one, attribute) for one in frames]
        columns[name] = np.array(rows, dtype).reshape([sizes[one] for one in letters])
    return columns


def long_columns(columns: Columns) -> dict[str, NDArray[Any]]:
    """Return columns in long form, one row for each time and marker, by name.

    Args:
        columns: ``t_us``, ``held``, ``confidence`` and any vectors ``(n, m, 2)`` by their keys in a
            file: ``displacement_px`` becomes ``displacement_x_px`` and ``displacement_y_px``.
            Forces ``(n, 3)`` are repeated for every marker.
    """
    estimates, markers = columns["held"].shape
    rows: dict[str, NDArray[Any]] = {
        "t_us": np.repeat(columns["t_us"], markers),
        "marker": np.tile(np.arange(markers), estimates),
    }
    for name, vector in columns.items():
        if vector.ndim == 3:
            rows |= _by_axis(name, vector.reshape(estimates * markers, 2))
    rows |= {name: columns[name].ravel() for name in ("held", "confidence")}
    for name in FORCES:
        if name in columns:
            rows |= _by_axis(name, np.repeat(columns[name], markers, axis=0))
    if "trigger" in columns:
        rows["trigger"] = np.repeat(columns["trigger"], markers)
    return rows


def _by_axis(name: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the columns of ``(n, 2 or 3)`` values, with the axis before the unit."""
    quantity, _, unit = name.rpartition("_")
    return {f"{quantity}_{axis}_{unit}": of for axis, of in zip("xyz", values.T, strict=False)}


def trigger_column(
    t_us: NDArray[np.int64], triggers: Columns, since_us: int | None = None
) -> dict[str, NDArray[Any]]:
    """Return the column ``trigger``: the channel of the last edge since the estimate before.

    Args:
        t_us: ``(n,)`` times of the estimates, us.
        triggers: Edges by their keys in a file, in order of time; none give no column.
        since_us: Time of the estimate before the first one; None where there is none.
    """
    edges_us, channel, _ = (triggers.get(name, np.zeros(0)) for name in TRIGGERS)
    if not len(edges_us):
        return {}
    before = 0 if since_us is None else np.searchsorted(edges_us, since_us, side="right")
    passed = np.searchsorted(edges_us, t_us, side="right")
    none = np.diff(passed, prepend=before) == 0
    return {"trigger": np.ma.MaskedArray(channel.astype(np.int16)[passed - 1], mask=none)}


class _Archive:
    """``tracks.npz``; equal frames give equal bytes."""

    def __init__(self, path: Path, reference_px: FloatArray) -> None:
        self._file = ColumnFile(path)
        self._file.set("reference_px", reference_px.astype(np.float32))
        self.append, self.abandon = self._file.append, self._file.abandon

    def close(self, meta: Mapping[str, Any], triggers: Columns) -> None:
        for name, values in triggers.items():
            self._file.set(name, values)
        self._file.set("meta", np.array(json.dumps(meta, sort_keys=True)))
        self._file.close()


class _CsvTable:
    """One line per time and marker, and the meta data beside it, in ``NAME.csv.json``."""

    def __init__(self, path: Path, _: FloatArray) -> None:
        self._target = WholeFile(path)
        self._file: IO[str] = self._target.open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._begun = False

    def append(self, columns: Columns) -> None:
        rows = long_columns(columns)
        if not self._begun:
            self._rows.writerow(rows)
            self._begun = True
        self._rows.writerows(zip(*(_texts(*item) for item in rows.items()), strict=True))

    def close(self, meta: Mapping[str, Any], triggers: Columns) -> None:
        path = self._target.path
        text = json.dumps(meta, indent=1, sort_keys=True) + "\n"
        write_text(path.with_name(path.name + ".json"), text)
        self._target.commit(self._file)

    def abandon(self) -> None:
        self._target.abandon(self._file)


def _texts(name: str, values: NDArray[Any]) -> list[Any]:
    if name == "held":
        return values.astype(int).tolist()
    if values.dtype.kind != "f":
        return values.tolist()
    form = "{:.3f}" if name == "confidence" else "{:z.4f}"  # z writes no -0.0000
    return [form.format(value) for value in values.tolist()]


class _ParquetTable:
    """The columns of the CSV file, with their types: for pandas, Polars, R and DuckDB."""

    def __init__(self, path: Path, _: FloatArray) -> None:
        self._parquet = import_extra("pyarrow.parquet", "Parquet", "parquet")
        self._target = WholeFile(path)
        self._file: Any = None
        self._stream: Any = None  # opened here: pyarrow takes no path outside of UTF-8

    def append(self, columns: Columns) -> None:
        import pyarrow

        rows = long_columns(columns)
        rows["marker"] = rows["marker"].astype(np.int16)
        table = pyarrow.table(rows)
        if self._file is None:
            # Neighbours in a float column share their high bytes, and hardly any value repeats.
            self._stream = self._target.open()
            self._file = self._parquet.ParquetWriter(
                self._stream,
                table.schema,
                compression="zstd",
                use_dictionary=["t_us", "marker"],
                use_byte_stream_split=[name for name in rows if rows[name].dtype.kind == "f"],
            )
        self._file.write_table(table)

    def close(self, meta: Mapping[str, Any], triggers: Columns) -> None:
        self._file.add_key_value_metadata({PARQUET_META: json.dumps(meta, sort_keys=True)})
        self._file.close()
        self._target.commit(self._stream)

    def abandon(self) -> None:
        if self._file is not None:
            self._file.close()
        self._target.abandon(self._stream)


class TracksWriter(WrittenWhole):
    """Takes frames one by one, and writes them at constant memory.

    Args:
        file: Takes the columns.
        markers: How many markers each frame has.

    Attributes:
        marks_rows: Whether trigger edges mark the rows, and must be told before them.
        triggers: The trigger edges, by their keys in a file.
        meta: What the file says of the whole; all that is known at the end.
    """

    def __init__(self, file: _Archive | _CsvTable | _ParquetTable, markers: int) -> None:
        self._file, self._markers, self.meta = file, markers, dict[str, Any]()
        self.marks_rows = not isinstance(file, _Archive)
        self._frames: list[tuple[MarkerFrame, Columns]] = []
        self.triggers: Columns = {}
        self._last_us: int | None = None

    def write(self, frame: MarkerFrame, measured: Columns | None = None) -> None:
        """Append a frame, and what else was measured then: the same names with every frame."""
        self._frames.append((frame, measured or {}))
        if len(self._frames) == FRAMES_PER_CHUNK:
            self._flush()

    def close(self) -> None:
        """Complete the file; only then it appears."""
        if self._frames or self._last_us is None:  # also where no frame came
            self._flush()
        self._file.close(self.meta, self.triggers)

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._file.abandon()

    def _flush(self) -> None:
        frames, self._frames = self._frames, []
        columns = stacked([frame for frame, _ in frames], self._markers)
        for name in frames[0][1] if frames else ():
            columns[name] = np.stack([row[name] for _, row in frames]).astype(np.float32)
        if self.marks_rows and frames:
            columns |= trigger_column(columns["t_us"], self.triggers, self._last_us)
        self._file.append(columns)
        self._last_us = frames[-1][0].t_us if frames else None


# Ending of a file -> what writes it.
FORMS = {".npz": _Archive, ".csv": _CsvTable, ".parquet": _ParquetTable}


def create_tracks(path: str | Path, reference_px: FloatArray) -> TracksWriter:
    """Return a writer of ``.npz``, or of ``.csv`` or ``.parquet`` in long form.

    Args:
        path: File to write.
        reference_px: ``(m, 2)`` markers at rest, px.

    Raises:
        ConfigError: The ending is none of these, or the folder does not exist.
        MissingExtraError: ``.parquet`` needs the extra ``[parquet]``.
    """
    form = FORMS[require_free(path, True, tuple(FORMS))]
    return TracksWriter(form(Path(path), reference_px), len(reference_px))
