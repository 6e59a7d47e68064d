"""What a file of this package holds, for errors where another kind of file was needed."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

TRACKS, TRUTH = {"t_us.npy", "displacement_px.npy"}, {"marker_t_us.npy", "marker_px.npy"}
"""Members of the archives that hold them."""
RECORDING = "events.raw"
"""What a recording folder has."""
CALIBRATION = {"schema", "grid", "reference_px"}
"""Keys of a calibration, which a force model has not."""
LARGEST_BYTES = 16 << 20
"""Larger JSON files are not looked into."""
TOLD = {
    "tracks": "it holds tracks, which spikingtac info, plot and compare read",
    "truth": "it holds the truth of a simulation, which spikingtac compare reads",
    "calibration": "it is a calibration: give it with --calibration, or to spikingtac info",
    "recording": "it is a recording, which spikingtac info, view and track read",
}
"""Kind -> what it is and what reads it."""


def kind_of(path: str | Path) -> str | None:
    """Return ``tracks``, ``truth``, ``calibration``, ``recording``, or None for anything else."""
    file = Path(path)
    if file.is_dir():
        return "recording" if (file / RECORDING).is_file() else None
    if not file.is_file():
        return None
    if zipfile.is_zipfile(file):
        return _kind_of_archive(file)
    return "calibration" if file.suffix == ".json" and _is_calibration(file) else None


def told_kind(path: str | Path) -> str | None:
    """Return what a file is, in words for an error, or None where it is nothing of ours."""
    kind = kind_of(path)
    return None if kind is None else TOLD[kind]


def _kind_of_archive(file: Path) -> str | None:
    try:
        with zipfile.ZipFile(file) as archive:
            names = set(archive.namelist())
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError):
        return None
    return "tracks" if names >= TRACKS else "truth" if names >= TRUTH else None


def _is_calibration(file: Path) -> bool:
    if file.stat().st_size > LARGEST_BYTES:
        return False
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and document.keys() >= CALIBRATION
