"""Export tracks into a data set: which recordings, which form, into a folder that is whole."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from spikingtac._version import package_version
from spikingtac.atomic_files import PARTIAL
from spikingtac.batch.inputs import find_recordings, outputs_of
from spikingtac.datasets.lerobot import INFO, write_lerobot
from spikingtac.errors import ConfigError, MissingExtraError
from spikingtac.tracks import FRAMES_PER_CHUNK, Tracks
from spikingtac.tracks.files import FORCES, PER_MARKER

Form = Literal["lerobot", "zarr"]

# Arrays of a recording, as tracks.npz names them; those that it lacks are left out.
ARRAYS = ("t_us", *PER_MARKER, *FORCES, "reference_px")
ATTRIBUTES = {"held": "coasted"}  # Array -> attribute of tracks, where the two differ.
CHUNK_ROWS = 16 * FRAMES_PER_CHUNK  # Times of a chunk.
MEMBERS = ("displacement_px.npy",)  # What tells tracks from other archives.

# Form -> the file that says that a folder is such a data set.
MARKS: dict[Form, str] = {"lerobot": INFO, "zarr": "zarr.json"}
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
    output = config.output
    _require_free(output, config.form, overwrite)
    found = find_recordings(config.sources, MEMBERS)
    if config.logs and len(config.logs) != len(found):
        raise ConfigError(
            f"there are {len(found)} recordings and {len(config.logs)} logs; give one for each, in "
            f"the order {', '.join(path.name for path in found[:3])} ..."
        )

    def told() -> Iterator[Path]:
        for number, path in enumerate(found, 1):
            yield path
            advance(number / len(found))

    partial = output.with_name(f".{output.name}{PARTIAL}{os.getpid()}")
    partial.mkdir(parents=True)
    try:
        if config.form == "zarr":
            names = [path.as_posix() for path in outputs_of(found, Path(), "")]
            figures = write_zarr(partial, zip(names, told(), strict=True))
        else:
            logs = config.logs or (None,) * len(found)
            pairs = zip(told(), logs, strict=True)
            figures = write_lerobot(partial, pairs, config.fps, config.task)
        if output.exists():
            shutil.rmtree(output)
        os.replace(partial, output)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {"output": str(output), **figures}


def _require_free(output: Path, form: Form, overwrite: bool) -> None:
    if not output.exists() or (output.is_dir() and not any(output.iterdir())):
        return
    if not output.is_dir():
        raise ConfigError(f"{str(output)!r} is a file; give the name of a folder")
    if not (output / MARKS[form]).is_file():
        raise ConfigError(
            f"{str(output)!r} is not empty and holds no {form} data set; give another folder"
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
            values = getattr(tracks, ATTRIBUTES.get(array, array))
            if values is not None:
                chunks = (max(1, min(len(values), CHUNK_ROWS)), *values.shape[1:])
                group.create_array(array, data=values, chunks=chunks)
        group.attrs.update(tracks.meta)
        count, frames = count + 1, frames + len(tracks.t_us)
    root.attrs.update({"package_version": package_version(), "recordings": count})
    return {"recordings": count, "frames": frames}
