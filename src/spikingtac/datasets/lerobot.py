"""A data set as LeRobot reads it, version v3.0: Parquet files and what describes them.

Source: LeRobot 0.6 (``datasets/dataset_metadata.py``, ``dataset_writer.py``, ``feature_utils.py``).
Episodes follow each other in files of some 100 MB, one row group each; ``meta`` holds
``info.json``, ``stats.json``, ``tasks.parquet`` and one row for each episode.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import write_json
from spikingtac.datasets.episode import Episode
from spikingtac.errors import ConfigError, MissingExtraError

VERSION = "v3.0"
"""The data set's version, ``CODEBASE_VERSION`` of LeRobot 0.4 to 0.6."""
INFO = "meta/info.json"
"""What says that a folder is such a data set; written last."""
CHUNK_FILES = 1_000
FILE_MB = 100
"""A file that is larger is followed by another one, MB (LeRobot's default)."""
BYTES_PER_MB = 1 << 20
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
INDICES = ("frame_index", "episode_index", "index", "task_index")

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Statistics = dict[str, NDArray[np.floating] | NDArray[np.integer]]
"""Name of a statistic -> ``(k,)`` values; ``count`` is ``(1,)``."""


def write_lerobot(folder: Path, episodes: Iterable[Episode], fps: int, task: str) -> dict[str, Any]:
    """Write a data set into an empty folder, one episode in memory at a time.

    Args:
        folder: An empty folder.
        episodes: All with the same features.
        fps: Frames per second.
        task: What is done in them, in words.

    Returns:
        ``info.json``.

    Raises:
        ConfigError: There is no episode, or one has other features than the first.
        MissingExtraError: pyarrow or pandas is not installed.
    """
    try:
        import pandas
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise MissingExtraError(
            "LeRobot data sets need: pip install 'spikingtac[lerobot]'"
        ) from error
    writer = _DataFiles(folder, pa, pq)
    rows: list[dict[str, Any]] = []
    parts: list[dict[str, Statistics]] = []
    described: dict[str, Any] = {}
    for number, episode in enumerate(episodes):
        features = _features(episode)
        if described and features != described:
            raise ConfigError(
                f"{episode.name!r} has other features than the first recording; a data set holds "
                "one sensor and one kind of log"
            )
        described = features
        columns = _columns(episode, number, writer.frames, fps)
        where = writer.add(columns)
        parts.append({name: statistics_of(_two(column)) for name, column in columns.items()})
        rows.append(_row(number, len(episode.t_us), writer.frames, task) | where | _told(parts[-1]))
    writer.close()
    if not rows:
        raise ConfigError("there is no episode to write")
    episode_file = folder / "meta" / "episodes" / FILE.format(chunk_index=0, file_index=0)
    episode_file.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(rows), episode_file)
    tasks = pandas.DataFrame({"task_index": [0]}, index=pandas.Index([task], name="task"))
    tasks.to_parquet(folder / "meta" / "tasks.parquet")
    total = {name: merged([part[name] for part in parts]) for name in parts[0]}
    write_json(folder / "meta" / "stats.json", {k: _plain(v) for k, v in total.items()})
    info = _info(described, fps, len(rows), writer.frames)
    write_json(folder / INFO, info)
    return info


class _DataFiles:
    """Episodes one after another in files of limited size."""

    def __init__(self, folder: Path, pa: Any, pq: Any) -> None:
        self._folder, self._pa, self._pq = folder / "data", pa, pq
        self._number = self._bytes = 0
        self._writer: Any = None
        self.frames = 0

    def add(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, int]:
        """Append an episode, and return where it is."""
        table = self._pa.table({name: self._array(column) for name, column in columns.items()})
        if self._writer is not None and self._bytes + table.nbytes > FILE_MB * BYTES_PER_MB:
            self.close()
            self._number, self._bytes = self._number + 1, 0
        chunk, file = divmod(self._number, CHUNK_FILES)
        if self._writer is None:
            path = self._folder / FILE.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = self._pq.ParquetWriter(path, table.schema)
        self._writer.write_table(table, row_group_size=len(table))
        self._bytes += table.nbytes
        self.frames += len(table)
        return {"data/chunk_index": chunk, "data/file_index": file}

    def close(self) -> None:
        """Complete the file."""
        if self._writer is not None:
            self._writer.close()
        self._writer = None

    def _array(self, column: NDArray[Any]) -> Any:
        if column.ndim == 1:
            return self._pa.array(column)
        flat = self._pa.array(column.ravel())
        return self._pa.FixedSizeListArray.from_arrays(flat, column.shape[1])


def _columns(episode: Episode, number: int, before: int, fps: int) -> dict[str, NDArray[Any]]:
    frame = np.arange(len(episode.t_us), dtype=np.int64)
    one = {name: v[:, 0] if v.shape[1] == 1 else v for name, v in episode.features.items()}
    return {
        **one,
        "timestamp": (frame / fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(len(frame), number, np.int64),
        "index": before + frame,
        "task_index": np.zeros(len(frame), np.int64),
    }


def _features(episode: Episode) -> dict[str, Any]:
    own = {
        name: {"dtype": "float32", "shape": [values.shape[1]], "names": list(episode.names[name])}
        for name, values in episode.features.items()
    }
    given = {"timestamp": "float32", **dict.fromkeys(INDICES, "int64")}
    return own | {n: {"dtype": kind, "shape": [1], "names": None} for n, kind in given.items()}


def _row(number: int, length: int, after: int, task: str) -> dict[str, Any]:
    return {
        "episode_index": number,
        "tasks": [task],
        "length": length,
        "dataset_from_index": after - length,
        "dataset_to_index": after,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }


def _told(statistics: Mapping[str, Statistics]) -> dict[str, list[float]]:
    return {
        f"stats/{name}/{kind}": values.tolist()
        for name, part in statistics.items()
        for kind, values in part.items()
    }


def _plain(statistics: Statistics) -> dict[str, list[float]]:
    return {kind: values.tolist() for kind, values in statistics.items()}


def _two(column: NDArray[Any]) -> NDArray[Any]:
    return column[:, None] if column.ndim == 1 else column


def _info(features: Mapping[str, Any], fps: int, episodes: int, frames: int) -> dict[str, Any]:
    return {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": FILE_MB,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": f"data/{FILE}",
        "video_path": None,
        "features": dict(features),
    }


def statistics_of(values: NDArray[np.floating] | NDArray[np.integer]) -> Statistics:
    """Return the statistics of ``(n, k)`` values, column by column, with the names of LeRobot.

    Source: LeRobot 0.6, ``datasets/compute_stats.py``. Quantiles are exact; LeRobot estimates them.
    """
    wide = values.astype(np.float64)
    quantiles = np.quantile(wide, list(QUANTILES.values()), axis=0)
    return {
        "min": wide.min(axis=0),
        "max": wide.max(axis=0),
        "mean": wide.mean(axis=0),
        "std": wide.std(axis=0),
        "count": np.array([len(wide)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def merged(parts: Sequence[Statistics]) -> Statistics:
    """Return the statistics of all frames from those of the episodes.

    Quantiles are means over episodes weighted by frames, as in LeRobot; the variance is that of
    Chan, Golub and LeVeque (1979).
    """
    counts = np.stack([part["count"] for part in parts]).astype(np.float64)
    total = counts.sum(axis=0)
    mean = sum(part["mean"] * count for part, count in zip(parts, counts, strict=True)) / total
    variance = (
        sum(
            (part["std"] ** 2 + (part["mean"] - mean) ** 2) * count
            for part, count in zip(parts, counts, strict=True)
        )
        / total
    )
    weighed = {
        name: sum(part[name] * count for part, count in zip(parts, counts, strict=True)) / total
        for name in QUANTILES
    }
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": np.asarray(mean),
        "std": np.sqrt(np.asarray(variance)),
        "count": total.astype(np.int64),
        **{name: np.asarray(value) for name, value in weighed.items()},
    }
