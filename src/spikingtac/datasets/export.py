"""Export tracks into a data set: which recordings, which form, into a folder that is whole."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from spikingtac._version import package_version
from spikingtac.atomic_files import PARTIAL
from spikingtac.batch.inputs import find_recordings, outputs_of
from spikingtac.datasets.episode import Episode
from spikingtac.datasets.lerobot import INFO, write_lerobot
from spikingtac.errors import ConfigError, MissingExtraError
from spikingtac.tracks import FRAMES_PER_CHUNK, Tracks
from spikingtac.tracks.columns import COLUMN_TYPES, FORCES

Form = Literal["lerobot", "zarr"]
ROOT = "zarr.json"  # What says that a folder is a Zarr store, version 3.

# Arrays of a recording, as tracks.npz names them; those that it lacks are left out.
ARRAYS = ("t_us", *COLUMN_TYPES, *FORCES, "reference_px")
CHUNK_ROWS = 16 * FRAMES_PER_CHUNK  # Times of a chunk.
MEMBERS = ("displacement_px.npy",)  # What tells tracks from other archives.

# Form -> the file that says that a folder is such a data set.
MARKS: dict[Form, str] = {"lerobot": INFO, "zarr": ROOT}
LARGEST_FPS = 1_000


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportConfig:
    """What is exported, and how.

    Attributes:
        sources: Tracks, folders of them, patterns.
        form: The form of the data set.
        output: Folder to write.
        fps: LeRobot: frames per second.
        task: LeRobot: what is done in the recordings, in words.
        logs: LeRobot: a robot's log for each recording, in their order; or none.
    """

    sources: tuple[Path, ...]
    form: Form
    output: Path
    fps: int = 30
    task: str = "touch"
    logs: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        if not 1 <= self.fps <= LARGEST_FPS:
            raise ConfigError(f"fps is {self.fps}, it must be 1 to {LARGEST_FPS}")
        if self.form == "zarr" and self.logs:
            raise ConfigError("a Zarr store holds the tracks as they are; logs go with lerobot")


def export(
    config: ExportConfig, overwrite: bool, advance: Callable[[float], None] = lambda share: None
) -> dict[str, Any]:
    """Export tracks; the folder appears whole or not at all.

    Returns:
        Figures of what was written.

    Raises:
        ConfigError: There are no tracks, logs do not fit them, or the folder may not be replaced.
        RecordingError: Tracks or a log cannot be read.
    """
    _require_free(config, overwrite)
    found = find_recordings(config.sources, MEMBERS)
    if config.logs and len(config.logs) != len(found):
        raise ConfigError(
            f"there are {len(found)} recordings and {len(config.logs)} logs; give one for each, in "
            f"the order {', '.join(path.name for path in found[:3])} ..."
        )
    partial = config.output.with_name(f".{config.output.name}{PARTIAL}{os.getpid()}")
    partial.mkdir(parents=True)
    try:
        if config.form == "zarr":
            names = [path.as_posix() for path in outputs_of(found, Path(), "")]
            told = _told(found, advance)
            figures = write_zarr(partial, zip(names, told, strict=True))
        else:
            figures = _lerobot(partial, config, found, advance)
        if config.output.exists():
            shutil.rmtree(config.output)
        os.replace(partial, config.output)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {"output": str(config.output), **figures}


def _lerobot(
    folder: Path, config: ExportConfig, found: Sequence[Path], advance: Callable[[float], None]
) -> dict[str, Any]:
    logs: Sequence[Path | None] = config.logs or [None] * len(found)
    ages: list[int] = []

    def episodes() -> Iterator[Episode]:
        for path, log in zip(_told(found, advance), logs, strict=True):
            episode = Episode.of(path, config.fps, log)
            ages.append(episode.largest_age_us)
            yield episode

    info = write_lerobot(folder, episodes(), config.fps, config.task)
    kept = {name: info[name] for name in ("total_episodes", "total_frames", "fps")}
    names = [name for name, one in info["features"].items() if one["names"]]
    return {**kept, "features": names, "largest_age_ms": max(ages) / 1e3}


def _told(found: Sequence[Path], advance: Callable[[float], None]) -> Iterator[Path]:
    for number, path in enumerate(found):
        yield path
        advance((number + 1) / len(found))


def _require_free(config: ExportConfig, overwrite: bool) -> None:
    output = config.output
    if not output.exists() or (output.is_dir() and not any(output.iterdir())):
        return
    if not output.is_dir():
        raise ConfigError(f"{str(output)!r} is a file; give the name of a folder")
    if not (output / MARKS[config.form]).is_file():
        raise ConfigError(
            f"{str(output)!r} is not empty and holds no {config.form} data set; give another folder"
        )
    if not overwrite:
        raise ConfigError(
            f"{str(output)!r} is there already; choose another name, or give --overwrite"
        )


def write_zarr(folder: Path, recordings: Iterable[tuple[str, Path]]) -> dict[str, Any]:
    """Write tracks into an empty folder, one recording in memory at a time.

    Args:
        folder: An empty folder.
        recordings: Name of the group, and tracks.npz.

    Returns:
        ``recordings`` and ``frames``, their numbers.

    Raises:
        MissingExtraError: zarr is not installed.
    """
    try:
        import zarr
    except ImportError as error:
        raise MissingExtraError("Zarr needs: pip install 'spikingtac[zarr]'") from error
    root = zarr.create_group(str(folder), zarr_format=3)
    count = frames = 0
    for name, path in recordings:
        tracks = Tracks.load(path)
        group = root.create_group(name)
        for array in ARRAYS:
            values = getattr(tracks, array)
            if values is not None:
                chunks = (max(1, min(len(values), CHUNK_ROWS)), *values.shape[1:])
                group.create_array(array, data=values, chunks=chunks)
        group.attrs.update(tracks.meta)
        count, frames = count + 1, frames + len(tracks.t_us)
    root.attrs.update({"package_version": package_version(), "recordings": count})
    return {"recordings": count, "frames": frames}
