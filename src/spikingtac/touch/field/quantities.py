"""Quantities of a whole displacement field, each with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.field.local_gradient import GradientOperator

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its standard deviation.

    Attributes:
        value: The number.
        sigma: Its standard deviation from the markers' noise alone.
    """

    value: float
    sigma: float


@dataclass(frozen=True, slots=True)
class FieldQuantities:
    """A displacement field in a few numbers.

    Attributes:
        mean_shear_x_px: Mean displacement along x, px.
        mean_shear_y_px: Mean displacement along y, px.
        torsion_rad: Rotation of the markers about their centre that fits best, rad.
        divergence: Mean growth of area; positive where the skin is spread.
        curl: Mean curl, twice the mean rotation, rad.
        strain: Root mean square of the gradient over the markers. Its noise adds to it, and the
            expected share is taken off; ``sigma`` is that of the rest.
    """

    mean_shear_x_px: Estimate
    mean_shear_y_px: Estimate
    torsion_rad: Estimate
    divergence: Estimate
    curl: Estimate
    strain: Estimate


class FieldGauge:
    """Measures displacement fields of one sensor.

    Example:
        >>> axes = np.meshgrid(np.arange(4.0), np.arange(4.0))
        >>> place = 37.0 * np.column_stack([axis.ravel() for axis in axes])
        >>> turned = 0.01 * (place - place.mean(axis=0)) @ [[0, 1], [-1, 0]]
        >>> round(FieldGauge(place, noise_px=0.1).measure(turned).torsion_rad.value, 4)
        0.01
    """

    def __init__(self, reference_px: Field, noise_px: float) -> None:
        """Prepare the gauge.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px.
            noise_px: Standard deviation of a marker's displacement, per axis, px.

        Raises:
            ConfigError: Too few markers.
        """
        self._away = reference_px - reference_px.mean(axis=0)
        self._gradient = GradientOperator(reference_px)
        self._noise = noise_px
        self._noise2 = (noise_px * self._gradient.noise_gain()) ** 2
        self._inertia = float((self._away**2).sum())
        unit = np.eye(2 * len(reference_px)).reshape(-1, len(reference_px), 2)
        answers = self._gradient.of(unit)
        self._of_divergence = answers.divergence.mean(axis=1)
        self._of_curl = answers.curl.mean(axis=1)

    def measure(self, displacement: Field) -> FieldQuantities:
        """Measure displacements ``(m, 2)``, px."""
        away, flat = self._away, displacement.ravel()
        mean, of_mean = displacement.mean(axis=0), self._noise / np.sqrt(len(away))
        moved = away + displacement - mean
        turned = float((away[:, 0] * moved[:, 1] - away[:, 1] * moved[:, 0]).sum())
        kept = float((away * moved).sum())
        torsion = Estimate(
            float(np.arctan2(turned, kept)), self._noise / float(np.sqrt(self._inertia))
        )
        square = float(self._gradient.of(displacement).strength) ** 2
        strain = float(np.sqrt(max(square - self._noise2, 0.0)))
        spread = float(np.sqrt(self._noise2 / len(away)))
        return FieldQuantities(
            Estimate(float(mean[0]), of_mean),
            Estimate(float(mean[1]), of_mean),
            torsion,
            self._linear(self._of_divergence, flat),
            self._linear(self._of_curl, flat),
            Estimate(strain, spread),
        )

    def _linear(self, weights: Field, flat: Field) -> Estimate:
        return Estimate(float(weights @ flat), self._noise * float(np.sqrt(weights @ weights)))
