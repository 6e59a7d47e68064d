"""Displacements of markers over time, with the wrench that made them where it was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import RecordingError

COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")
"""Columns of a wrench: forces in N, then moments in Nm."""
UNITS = ("mm", "px")
"""Units that displacements can have."""
DIMENSIONS = (2, 3)
"""Coordinates that a marker can have: in the image, or with depth."""


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

    def __post_init__(self) -> None:
        frames, markers = len(self.t_us), len(self.reference)
        if self.displacement.shape[:2] != (frames, markers) or self.displacement.ndim != 3:
            raise RecordingError(
                f"{self.name}: displacements are {self.displacement.shape}, times {frames} and "
                f"markers {markers}; they must be (times, markers, 2 or 3)"
            )
        dimensions = self.displacement.shape[2]
        if dimensions not in DIMENSIONS or self.reference.shape != (markers, dimensions):
            raise RecordingError(
                f"{self.name}: displacements have {dimensions} coordinates, the markers' places "
                f"are {self.reference.shape}; both must have 2 or 3 for each marker"
            )
        if len(self.wrench) != frames or self.wrench.ndim != 2:
            raise RecordingError(
                f"{self.name}: the wrench is {self.wrench.shape}, it must have {frames} rows"
            )
        if self.wrench.shape[1] > len(COMPONENTS):
            raise RecordingError(
                f"{self.name}: the wrench has {self.wrench.shape[1]} columns, at most "
                f"{len(COMPONENTS)} are known: {', '.join(COMPONENTS)}"
            )
        if self.unit not in UNITS:
            raise RecordingError(f"{self.name}: the unit is {self.unit!r}, valid: mm, px")
        if not (np.isfinite(self.displacement).all() and np.isfinite(self.wrench).all()):
            raise RecordingError(f"{self.name}: displacements or forces are not finite numbers")
        if frames > 1 and not (np.diff(self.t_us) >= 0).all():
            raise RecordingError(f"{self.name}: the times run backwards; sort the rows by t_us")

    def in_image(self) -> WrenchSeries:
        """Return the series without depth: what one camera sees."""
        return WrenchSeries(
            self.t_us,
            self.reference[:, :2],
            self.displacement[:, :, :2],
            self.wrench,
            self.unit,
            self.name,
        )

    def part(self, rows: NDArray[np.bool_]) -> WrenchSeries:
        """Return the rows of a mask as a series of their own."""
        return WrenchSeries(
            self.t_us[rows],
            self.reference,
            self.displacement[rows],
            self.wrench[rows],
            self.unit,
            self.name,
        )
