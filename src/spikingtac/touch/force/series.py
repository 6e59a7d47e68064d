"""Displacements of markers over time, with the wrench that made them where it was measured."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.arrays import one_line
from spikingtac.errors import RecordingError

# Columns of a wrench: forces in N, then moments in Nm.
COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")
UNITS = ("mm", "px")
ARRAY_KEYS = ("t_us", "reference_mm", "displacement_mm")

# Keys of a file of arrays, and of tracks; ``wrench (n, 6)`` may come with either.
TRACK_KEYS = ("t_us", "reference_px", "detected_px")


@dataclass(frozen=True, slots=True)
class WrenchSeries:
    """One uninterrupted series of labelled contacts.

    Attributes:
        t_us: ``(n,)`` times, us.
        reference: ``(m, d)`` markers at rest, in ``unit``.
        displacement: ``(n, m, d)`` displacements, in ``unit``; d is 2 (in the image) or 3.
        wrench: ``(n, c)`` forces in N and moments in Nm, the first c of :data:`COMPONENTS`; no
            columns where nothing was measured. In whichever frame the labels have.
        unit: ``"mm"`` or ``"px"``.
        name: Where it came from, for messages.
    """

    t_us: NDArray[np.int64]
    reference: NDArray[np.float64]
    displacement: NDArray[np.float64]
    wrench: NDArray[np.float64]
    unit: str
    name: str = "series"

    __repr__ = one_line

    def __post_init__(self) -> None:
        frames, moved = len(self.t_us), self.displacement
        if moved.ndim != 3 or moved.shape != (frames, *self.reference.shape):
            raise RecordingError(
                f"{self.name}: {frames} times, markers of {self.reference.shape} and displacements "
                f"of {moved.shape}; these must be (times, markers, coordinates)"
            )
        if moved.shape[2] not in (2, 3) or self.unit not in UNITS:
            raise RecordingError(
                f"{self.name}: {moved.shape[2]} coordinates in {self.unit!r}; valid are 2 or 3 "
                "in mm or px"
            )
        if len(self.wrench) != frames or self.wrench.shape[1:] > (len(COMPONENTS),):
            raise RecordingError(
                f"{self.name}: the wrench is {self.wrench.shape}, it must have {frames} rows and "
                f"at most the columns {', '.join(COMPONENTS)}"
            )
        if not (np.isfinite(moved).all() and np.isfinite(self.wrench).all()):
            raise RecordingError(f"{self.name}: displacements or forces are not finite numbers")
        if (np.diff(self.t_us) < 0).any():
            raise RecordingError(f"{self.name}: the times run backwards; sort the rows by t_us")

    def in_image(self) -> WrenchSeries:
        """Return the series without depth: what one camera sees."""
        reference, moved = self.reference[:, :2], self.displacement[:, :, :2]
        return replace(self, reference=reference, displacement=moved)

    def part(self, rows: NDArray[Any]) -> WrenchSeries:
        """Return the rows of a mask or of indices as a series of their own."""
        return replace(
            self,
            t_us=self.t_us[rows],
            displacement=self.displacement[rows],
            wrench=self.wrench[rows],
        )


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
    source, wanted = Path(path), {*ARRAY_KEYS, *TRACK_KEYS, "wrench"}
    try:
        with np.load(source, allow_pickle=False) as archive:
            values = {name: archive[name] for name in archive.files if name in wanted}
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
    rest, away, labels = (one.astype(np.float64) for one in (reference, moved, wrench))
    return WrenchSeries(values["t_us"].astype(np.int64), rest, away, labels, unit, source.name)
