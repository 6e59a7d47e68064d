"""The peak of a touch: when the skin is deformed most, and what is measured there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.contact_patch.estimator import PatchEstimator
from spikingtac.touch.contact_patch.patch import Patch
from spikingtac.touch.field.quantities import FieldGauge
from spikingtac.touch.touches.touch import Touch

Field = NDArray[np.float64]


@dataclass(slots=True)
class TouchPeak:
    """The most of an open touch so far.

    Attributes:
        field: ``(m, 2)`` displacements where the skin is deformed most, px.
        strength: Strength of their gradient.
        t_us: When that was, us.
        largest_px: Largest displacement of a marker, whenever it was, px.
        spread: Largest displacement that most of the markers reach, whenever it was, px.
    """

    field: Field
    strength: float = 0.0
    t_us: int = 0
    largest_px: float = 0.0
    spread: float = 0.0


class PeakGauge:
    """Measures peaks on one sensor."""

    def __init__(self, reference_px: Field, scatter_px: float) -> None:
        """Prepare the patch estimator and the field's gauge.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px.
            scatter_px: Standard deviation of a marker's place, per axis, px.

        Raises:
            ConfigError: Too few markers.
        """
        self._patches = PatchEstimator(reference_px)
        self._fields = FieldGauge(reference_px, scatter_px)

    def patch(self, peak: TouchPeak) -> Patch:
        """Return the touched part of the skin."""
        return self._patches.patch(peak.field)

    def touch(self, begin_us: int, end_us: int | None, peak: TouchPeak) -> Touch:
        """Return the touch of a peak from its begin to its end."""
        patch = self.patch(peak)
        return Touch(
            begin_us=begin_us,
            end_us=end_us,
            peak_us=peak.t_us,
            peak_strength=peak.strength,
            peak_displacement_px=peak.largest_px,
            place_px=patch.place,
            area_px2=patch.area,
            outline_px=patch.outline,
            field=self._fields.measure(peak.field),
        )
