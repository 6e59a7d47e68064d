"""A data set as LeRobot reads it, version v3.0: Parquet files and what describes them.

Source: LeRobot 0.6 (``datasets/dataset_metadata.py``, ``dataset_writer.py``, ``feature_utils.py``).
Episodes follow each other in one file, one row group each; ``meta`` holds ``info.json``,
``stats.json``, ``tasks.parquet`` and one row for each episode.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import write_json
from spikingtac.errors import ConfigError, RecordingError, import_extra
from spikingtac.events.formats.array_file import load_arrays
from spikingtac.tracks import Tracks
from spikingtac.types import US_PER_S

LARGEST_FPS = 1_000
VERSION = "v3.0"  # The data set's version, ``CODEBASE_VERSION`` of LeRobot 0.4 to 0.6.
INFO = "meta/info.json"  # What says that a folder is such a data set; written last.
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
FIRST_FILE = FILE.format(chunk_index=0, file_index=0)
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

# Displacements, px: x and y of every marker, row by row.
DISPLACEMENT = "observation.tactile.displacement"
SEEN = "observation.tactile.seen"  # 1 where a marker was seen, 0 where its place is a prediction.

# Forces in N, then moments in Nm, where a force model told them.
WRENCH = "observation.tactile.wrench"
LOG_NAMES = {"state": "observation.state", "action": "action"}  # Array of a robot's log -> feature.

# Columns of indices: in the episode, of it, in the data set, of the task.
INDICES = ("frame_index", "episode_index", "index", "task_index")

# Columns that say which files hold an episode.
EPISODE_FILES = [
    f"{f}/{kind}_index" for f in ("data", "meta/episodes") for kind in ("chunk", "file")
]

# What is the same in every ``info.json``.
ABOUT = {
    "codebase_version": VERSION,
    "robot_type": None,
    "total_tasks": 1,
    "chunks_size": 1_000,
    "data_files_size_in_mb": 100,
    "video_files_size_in_mb": 200,
    "data_path": f"data/{FILE}",
    "video_path": None,
}

Columns = dict[str, NDArray[Any]]  # Name of a feature -> ``(n,)`` or ``(n, k)`` values.


def write_lerobot(
    folder: Path,
    recordings: Sequence[Path],
    logs: Sequence[Path],
    fps: int,
    task: str,
    advance: Callable[[float], object] = bool,
) -> dict[str, Any]:
    """Write a data set into an empty folder.

    Args:
        folder: An empty folder.
        recordings: tracks.npz of each episode.
        logs: A robot's log of each on the same clock, or none at all.
        fps: Frames per second.
        task: What is done in them, in words.
        advance: Told the share that is done, 0 to 1.

    Returns:
        Figures of what was written.

    Raises:
        RecordingError: A file cannot be read, or holds nothing, or no finite number for a frame.
        ConfigError: One has other features than the first, or does not overlap its log; or there
            are fewer or more logs than recordings.
        MissingExtraError: pyarrow or pandas is not installed.
    """
    if not 1 <= fps <= LARGEST_FPS:
        raise ConfigError(f"fps is {fps}, it must be 1 to {LARGEST_FPS}")
    if logs and len(logs) != len(recordings):
        raise ConfigError(
            f"there are {len(recordings)} recordings and {len(logs)} logs; give one for each, in "
            f"the order {', '.join(path.name for path in recordings[:3])} ..."
        )
    for library in ("pyarrow", "pandas"):
        import_extra(library, "a data set of LeRobot", "lerobot")
    kept, episodes, ages_us, described = list[Columns](), list[dict[str, Any]](), [0], {}
    for number, path in enumerate(recordings):
        features, age_us = _frames_of(path, fps, logs[number] if logs else None)
        told = _described(features)
        if described and told != described:
            raise ConfigError(
                f"{path.stem!r} has other features than the first recording; a data set holds "
                "one sensor and one kind of log"
            )
        described, before = told, sum(row["length"] for row in episodes)
        kept.append(_columns(features, number, before, fps))
        episodes.append(_episode(kept[-1], number, before, task))
        ages_us.append(age_us)
        advance((number + 1) / len(recordings))
    # Frames and episodes, then what describes them all: statistics and the layout.
    _write_tables(folder, kept, episodes, task)
    whole = {name: np.concatenate([columns[name] for columns in kept]) for name in kept[0]}
    write_json(folder / "meta" / "stats.json", {k: _statistics_of(v) for k, v in whole.items()})
    count = {"total_episodes": len(kept), "total_frames": len(whole["index"]), "fps": fps}
    splits = {"train": f"0:{len(kept)}"}
    write_json(folder / INFO, {**ABOUT, **count, "splits": splits, "features": described})
    names = [name for name, one in described.items() if one["names"]]
    return {**count, "features": names, "largest_age_ms": max(ages_us) / 1e3}


def _write_tables(
    folder: Path, kept: list[Columns], episodes: list[dict[str, Any]], task: str
) -> None:
    """Write the frames, one row group an episode, the table of episodes, and that of tasks."""
    import pandas
    import pyarrow as pa
    import pyarrow.parquet as pq

    for name in ("data", "meta/episodes"):
        (folder / name / FIRST_FILE).parent.mkdir(parents=True)
    tables = [pa.table({name: _array(pa, c) for name, c in columns.items()}) for columns in kept]
    # Files are opened here: pyarrow takes no path outside of UTF-8.
    data = (folder / "data" / FIRST_FILE).open("wb")
    with data, pq.ParquetWriter(data, tables[0].schema) as writer:
        for table in tables:
            writer.write_table(table, row_group_size=len(table))
    with (folder / "meta" / "episodes" / FIRST_FILE).open("wb") as file:
        pq.write_table(pa.Table.from_pylist(episodes), file)
    tasks = pandas.DataFrame({"task_index": [0]}, index=pandas.Index([task], name="task"))
    with (folder / "meta" / "tasks.parquet").open("wb") as file:
        tasks.to_parquet(file)


def _episode(columns: Columns, number: int, before: int, task: str) -> dict[str, Any]:
    """Return the row of an episode in ``meta``: where its frames are, and their statistics."""
    length = len(columns["index"])
    return {
        "episode_index": number,
        "tasks": [task],
        "length": length,
        "dataset_from_index": before,
        "dataset_to_index": before + length,
        **dict.fromkeys(EPISODE_FILES, 0),
        **{
            f"stats/{name}/{kind}": values
            for name, column in columns.items()
            for kind, values in _statistics_of(column).items()
        },
    }


def _frames_of(path: Path, fps: int, log: Path | None = None) -> tuple[Columns, int]:
    """Read tracks, and a log on the same clock, and bring them to the same frames.

    A frame gets the last values before it, as a robot would have had them; nothing is
    interpolated from the future. Frames are where tracks and log overlap.

    Args:
        path: tracks.npz.
        fps: Frames per second.
        log: ``.npz`` with ``t_us (n,)`` and ``state (n, k)``, ``action (n, k)`` or both.

    Returns:
        Feature -> ``(n, k)`` float32, and how old the oldest value is that a frame was given, us.
    """
    tracks = Tracks.load(path)
    if not len(tracks.t_us):
        raise RecordingError(f"{str(path)!r} holds no estimate")
    values = {
        DISPLACEMENT: tracks.displacement_px.reshape(len(tracks.t_us), -1),
        SEEN: ~tracks.coasted,
    }
    values |= {} if tracks.wrench is None else {WRENCH: tracks.wrench}
    sources = [(path, tracks.t_us, values), *([(log, *_log(log))] if log else [])]
    first_us, last_us = max(t[0] for _, t, _ in sources), min(t[-1] for _, t, _ in sources)
    if last_us < first_us:
        raise ConfigError(
            f"{str(path)!r} and its log do not overlap: one ends at {last_us} us, the other begins "
            f"at {first_us} us; both must be on the same clock"
        )
    count = int((last_us - first_us) * fps // US_PER_S) + 1
    t_us = first_us + np.arange(count, dtype=np.int64) * US_PER_S // fps
    features, age_us = Columns(), 0
    for file, own_us, of in sources:
        rows = np.searchsorted(own_us, t_us, "right") - 1
        age_us = max(age_us, int((t_us - own_us[rows]).max()))
        told = {name: np.ascontiguousarray(v[rows], np.float32) for name, v in of.items()}
        _require_numbers(file, told, own_us[rows])
        features |= told
    return features, age_us


def _require_numbers(file: Path, features: Columns, t_us: NDArray[np.int64]) -> None:
    """Refuse "not a number" and infinity, which would spoil the statistics and every training."""
    for name, values in features.items():
        for frame, column in np.argwhere(~np.isfinite(values))[:1].tolist():
            raise RecordingError(
                f"{str(file)!r}: {name}, column {column}, is {values[frame, column]} at "
                f"{t_us[frame]} us; a data set holds finite numbers: fill it, or cut it out"
            )


def _log(path: Path) -> tuple[NDArray[np.int64], Columns]:
    """Return the times of a robot's log, and its features."""
    arrays = load_arrays(path, "a robot's log")
    found = {feature: arrays[name] for name, feature in LOG_NAMES.items() if name in arrays}
    t_us = arrays.get("t_us", np.zeros(0))
    shapes = [v.ndim == 2 and len(v) == len(t_us) and v.dtype.kind in "fiu" for v in found.values()]
    timed = t_us.ndim == 1 and t_us.dtype.kind in "iu" and len(t_us) > 0
    if not (timed and shapes and all(shapes) and (np.diff(t_us.astype(np.int64)) >= 0).all()):
        raise RecordingError(
            f"{str(path)!r} is no log of a robot: it needs t_us (n,) (whole us, in order), and "
            "state (n, k), action (n, k) or both"
        )
    return t_us.astype(np.int64), found


def _described(features: Columns) -> dict[str, Any]:
    """Return each feature with its type, its shape, and the names of its columns."""
    told = {}
    for feature, values in features.items():
        count, short = values.shape[1], feature.rpartition(".")[2]
        names = {
            DISPLACEMENT: [f"{axis}_{marker}" for marker in range(count // 2) for axis in "xy"],
            SEEN: [f"marker_{marker}" for marker in range(count)],
            WRENCH: ["fx", "fy", "fz", "tx", "ty", "tz"][:count],
        }.get(feature, [f"{short}_{number}" for number in range(count)])
        told[feature] = {"dtype": "float32", "shape": [count], "names": names}
    given = {"timestamp": "float32", **dict.fromkeys(INDICES, "int64")}
    return told | {n: {"dtype": kind, "shape": [1], "names": None} for n, kind in given.items()}


def _columns(features: Columns, number: int, before: int, fps: int) -> Columns:
    frame = np.arange(len(features[SEEN]), dtype=np.int64)
    indices = (frame, np.full(len(frame), number), before + frame, np.zeros(len(frame), np.int64))
    return {
        **{name: v[:, 0] if v.shape[1] == 1 else v for name, v in features.items()},
        "timestamp": (frame / fps).astype(np.float32),
        **dict(zip(INDICES, indices, strict=True)),
    }


def _array(pa: Any, column: NDArray[Any]) -> Any:
    flat = pa.array(column.ravel())
    return flat if column.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, column.shape[1])


def _statistics_of(values: NDArray[Any]) -> dict[str, list[float]]:
    """Return the statistics of ``(n,)`` or ``(n, k)`` values, with the names of LeRobot.

    Source: LeRobot 0.6, ``datasets/compute_stats.py``. Quantiles are exact; LeRobot estimates them.
    """
    wide = values.reshape(len(values), -1).astype(np.float64)
    told = {name: getattr(wide, name)(axis=0).tolist() for name in ("min", "max", "mean", "std")}
    quantiles = {name: np.quantile(wide, q, axis=0).tolist() for name, q in QUANTILES.items()}
    return {**told, "count": [len(wide)], **quantiles}
