"""Tracks as a Zarr store: a group for each recording, arrays as in tracks.npz, at full rate."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac._version import package_version
from spikingtac.errors import ConfigError, MissingExtraError
from spikingtac.tracks import FRAMES_PER_CHUNK, Tracks

ROOT = "zarr.json"
"""What says that a folder is a Zarr store, version 3."""
ARRAYS = {
    "t_us": "t_us",
    "detected_px": "detected_px",
    "position_px": "position_px",
    "displacement_px": "displacement_px",
    "held": "coasted",
    "confidence": "confidence",
    "wrench_estimate": "wrench_estimate",
    "wrench_half_width": "wrench_half_width",
    "wrench_distance": "wrench_distance",
}
"""Name of an array -> field of the tracks; those that a recording lacks are left out."""
CHUNK_ROWS = 16 * FRAMES_PER_CHUNK
"""Times of a chunk."""


def write_zarr(folder: Path, recordings: Iterable[tuple[str, Path]]) -> dict[str, Any]:
    """Write tracks into an empty folder, one recording in memory at a time.

    Args:
        folder: An empty folder.
        recordings: Name of the group, and tracks.npz.

    Returns:
        ``recordings`` and ``frames``, their numbers.

    Raises:
        ConfigError: There is no recording.
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
        for array, field in ARRAYS.items():
            values = getattr(tracks, field)
            if values is not None:
                group.create_array(array, data=values, chunks=_chunks(values))
        group.create_array("reference_px", data=tracks.reference_px)
        group.attrs.update(tracks.meta)
        count, frames = count + 1, frames + len(tracks.t_us)
    if count == 0:
        raise ConfigError("there are no tracks to write")
    root.attrs.update({"package_version": package_version(), "recordings": count})
    return {"recordings": count, "frames": frames}


def _chunks(values: np.ndarray) -> tuple[int, ...]:
    return (max(1, min(len(values), CHUNK_ROWS)), *values.shape[1:])
