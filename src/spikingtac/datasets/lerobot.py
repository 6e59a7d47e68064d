"""A data set as LeRobot reads it, version v3.0: Parquet files and what describes them.

Source: LeRobot 0.6 (``datasets/dataset_metadata.py``, ``dataset_writer.py``, ``feature_utils.py``).
Episodes follow each other in one file, one row group each; ``meta`` holds ``info.json``,
``stats.json``, ``tasks.parquet`` and one row for each episode.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import write_json
from spikingtac.datasets.episode import Episode
from spikingtac.errors import ConfigError, MissingExtraError

VERSION = "v3.0"  # The data set's version, ``CODEBASE_VERSION`` of LeRobot 0.4 to 0.6.
INFO = "meta/info.json"  # What says that a folder is such a data set; written last.
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
FIRST_FILE = FILE.format(chunk_index=0, file_index=0)
INDICES = ("frame_index", "episode_index", "index", "task_index")
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Columns = dict[str, NDArray[Any]]  # Name of a feature -> ``(n,)`` or ``(n, k)`` values.


def write_lerobot(folder: Path, episodes: Iterable[Episode], fps: int, task: str) -> dict[str, Any]:
    """Write a data set into an empty folder.

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
    kept, rows, frames = list[Columns](), list[dict[str, Any]](), 0
    described: dict[str, Any] = {}
    for number, episode in enumerate(episodes):
        features = _features(episode)
        if described and features != described:
            raise ConfigError(
                f"{episode.name!r} has other features than the first recording; a data set holds "
                "one sensor and one kind of log"
            )
        described = features
        kept.append(_columns(episode, number, frames, fps))
        rows.append(_row(number, len(episode.t_us), frames, task) | _told(kept[-1]))
        frames += len(episode.t_us)
    if not rows:
        raise ConfigError("there is no episode to write")
    for name in ("data", "meta/episodes"):
        (folder / name / FIRST_FILE).parent.mkdir(parents=True)
    tables = [pa.table({name: _array(pa, c) for name, c in columns.items()}) for columns in kept]
    with pq.ParquetWriter(folder / "data" / FIRST_FILE, tables[0].schema) as writer:
        for table in tables:
            writer.write_table(table, row_group_size=len(table))
    pq.write_table(pa.Table.from_pylist(rows), folder / "meta" / "episodes" / FIRST_FILE)
    tasks = pandas.DataFrame({"task_index": [0]}, index=pandas.Index([task], name="task"))
    tasks.to_parquet(folder / "meta" / "tasks.parquet")
    whole = {name: np.concatenate([columns[name] for columns in kept]) for name in kept[0]}
    write_json(folder / "meta" / "stats.json", {k: statistics_of(v) for k, v in whole.items()})
    info = _info(described, fps, len(rows), frames)
    write_json(folder / INFO, info)
    return info


def _array(pa: Any, column: NDArray[Any]) -> Any:
    if column.ndim == 1:
        return pa.array(column)
    return pa.FixedSizeListArray.from_arrays(pa.array(column.ravel()), column.shape[1])


def _columns(episode: Episode, number: int, before: int, fps: int) -> Columns:
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


def _row(number: int, length: int, before: int, task: str) -> dict[str, Any]:
    files = ("data/chunk_index", "data/file_index", "meta/episodes/chunk_index",
             "meta/episodes/file_index")  # fmt: skip
    return {
        "episode_index": number,
        "tasks": [task],
        "length": length,
        "dataset_from_index": before,
        "dataset_to_index": before + length,
        **dict.fromkeys(files, 0),
    }


def _told(columns: Columns) -> dict[str, list[float]]:
    return {
        f"stats/{name}/{kind}": values
        for name, column in columns.items()
        for kind, values in statistics_of(column).items()
    }


def _info(features: Mapping[str, Any], fps: int, episodes: int, frames: int) -> dict[str, Any]:
    return {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": 1_000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": f"data/{FILE}",
        "video_path": None,
        "features": dict(features),
    }


def statistics_of(values: NDArray[Any]) -> dict[str, list[float]]:
    """Return the statistics of ``(n,)`` or ``(n, k)`` values, with the names of LeRobot.

    Source: LeRobot 0.6, ``datasets/compute_stats.py``. Quantiles are exact; LeRobot estimates them.
    """
    wide = values.reshape(len(values), -1).astype(np.float64)
    quantiles = np.quantile(wide, list(QUANTILES.values()), axis=0).tolist()
    return {
        **{name: getattr(wide, name)(axis=0).tolist() for name in ("min", "max", "mean", "std")},
        "count": [len(wide)],
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }
