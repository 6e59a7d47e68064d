"""One touch, and what is known of it when it is over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.field.quantities import FieldQuantities


@dataclass(frozen=True, slots=True)
class Touch:
    """A touch from its first motion to its release.

    Lengths are in the unit of the detector's markers: px, or mm where it was set to that.

    Attributes:
        begin_us: When the skin began to move, us.
        end_us: When the skin was released, us; None where the recording ended first.
        peak_us: When the skin was deformed most, us.
        peak_strength: Strength of the displacement's gradient then (1 is 100 % strain).
        peak_displacement_px: Largest displacement of a marker over the touch, px.
        place_px: ``(2,)`` centre of the contact patch at the peak, px.
        area_px2: Area of that patch, px squared.
        outline_px: ``(k, 2)`` its convex outline, px.
        field: Shear, torsion, divergence, curl and strain of the whole field at the peak, with the
            deviations of markers that scatter by ``TouchConfig.least_displacement_px``.
    """

    begin_us: int
    end_us: int | None
    peak_us: int
    peak_strength: float
    peak_displacement_px: float
    place_px: NDArray[np.float64]
    area_px2: float
    outline_px: NDArray[np.float64]
    field: FieldQuantities

    @property
    def duration_us(self) -> int | None:
        """Time from begin to end, us; None where the end was not seen."""
        return None if self.end_us is None else self.end_us - self.begin_us
