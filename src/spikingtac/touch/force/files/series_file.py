"""Series of displacements from files: tracks, or arrays of another sensor."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import RecordingError
from spikingtac.touch.force.wrench_series import WrenchSeries

ARRAY_KEYS = ("t_us", "reference_mm", "displacement_mm")
"""Keys of a file of arrays; ``wrench (n, 6)`` may come with them."""
TRACK_KEYS = ("t_us", "reference_px", "detected_px")
"""Keys of ``tracks.npz`` that are read; ``wrench (n, 6)`` may come with them."""


def is_series(path: Path) -> bool:
    """Return whether a file holds tracks or arrays, and no events."""
    if path.suffix != ".npz" or not path.is_file():
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
    except (zipfile.BadZipFile, OSError):
        return False
    return names.issuperset(ARRAY_KEYS) or names.issuperset(TRACK_KEYS)


def load_series(path: str | Path) -> WrenchSeries:
    """Read displacements, in mm from arrays or in px from tracks, with the wrench if there is one.

    Raises:
        RecordingError: The file cannot be read or holds neither.
    """
    source = Path(path)
    try:
        with np.load(source, allow_pickle=False) as archive:
            values: dict[str, NDArray[Any]] = {
                str(name): archive[name]
                for name in archive.files
                if name in (*ARRAY_KEYS, *TRACK_KEYS, "wrench")
            }
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise RecordingError(f"cannot read displacements from {str(path)!r}: {error}") from error
    if all(name in values for name in ARRAY_KEYS):
        reference, moved, unit = values["reference_mm"], values["displacement_mm"], "mm"
    elif all(name in values for name in TRACK_KEYS):
        reference, unit = values["reference_px"], "px"
        moved = values["detected_px"] - reference
    else:
        raise RecordingError(
            f"{str(path)!r} holds no displacements; it must hold t_us, reference_mm and "
            "displacement_mm, or be the tracks of: spikingtac track RECORDING"
        )
    wrench = values.get("wrench", np.empty((len(values["t_us"]), 0)))
    return WrenchSeries(
        values["t_us"].astype(np.int64),
        reference.astype(np.float64),
        moved.astype(np.float64),
        wrench.astype(np.float64),
        unit,
        source.name,
    )
