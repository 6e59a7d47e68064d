"""Tracks as a data set in a folder that is whole: which folder, and a Zarr store."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spikingtac._version import package_version
from spikingtac.atomic_files import whole_folder
from spikingtac.batch.inputs import outputs_of
from spikingtac.datasets.lerobot import INFO
from spikingtac.errors import ConfigError, import_extra
from spikingtac.tracks import FRAMES_PER_CHUNK, Tracks
from spikingtac.tracks.files import ATTRIBUTES, FORCES, PER_MARKER

# Arrays of a recording, as tracks.npz names them; those that it lacks are left out.
ARRAYS = ("t_us", *PER_MARKER, *FORCES, "reference_px")
CHUNK_ROWS = 16 * FRAMES_PER_CHUNK  # Times of a chunk.
MARKS = {"lerobot": INFO, "zarr": "zarr.json"}  # Form -> the file that tells such a data set.


@contextmanager
def data_set(folder: Path, form: str, overwrite: bool) -> Iterator[Path]:
    """Yield a folder to write a data set to; it appears in its place whole or not at all.

    Args:
        folder: Where the data set shall be.
        form: A key of :data:`MARKS`.
        overwrite: Whether a data set of that form is replaced; nothing else ever is.

    Raises:
        ConfigError: The place is a file, holds something else, or may not be replaced.
    """
    if folder.is_file():
        raise ConfigError(f"{str(folder)!r} is a file; give the name of a folder")
    if folder.is_dir() and any(folder.iterdir()):
        if not (folder / MARKS[form]).is_file():
            raise ConfigError(
                f"{str(folder)!r} is not empty and holds no {form} data set; give another folder"
            )
        if not overwrite:
            raise ConfigError(
                f"{str(folder)!r} is there already; choose another name, or give --overwrite"
            )
    with whole_folder(folder, last=Path(MARKS[form]).parts[0]) as partial:
        yield partial
        shutil.rmtree(folder, ignore_errors=True)


def write_zarr(
    folder: Path, recordings: Sequence[Path], advance: Callable[[float], object]
) -> dict[str, Any]:
    """Write tracks into an empty folder, one recording in memory at a time.

    Args:
        folder: An empty folder.
        recordings: Each tracks.npz.
        advance: Told the share that is done, 0 to 1.

    Returns:
        ``recordings`` and ``frames``, their numbers.

    Raises:
        MissingExtraError: zarr is not installed.
        RecordingError: Tracks cannot be read.
    """
    zarr = import_extra("zarr", "Zarr", "zarr")
    root, frames = zarr.create_group(str(folder), zarr_format=3), 0
    names = outputs_of(recordings, Path(), "")
    for number, (name, path) in enumerate(zip(names, recordings, strict=True), 1):
        tracks, group = Tracks.load(path), root.create_group(name.as_posix())
        for array in ARRAYS:
            values = getattr(tracks, ATTRIBUTES.get(array, array))
            if values is not None:
                chunks = (max(1, min(len(values), CHUNK_ROWS)), *values.shape[1:])
                group.create_array(array, data=values, chunks=chunks)
        group.attrs.update(tracks.meta)
        frames += len(tracks.t_us)
        advance(number / len(names))
    root.attrs.update({"package_version": package_version(), "recordings": len(names)})
    return {"recordings": len(names), "frames": frames}
