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

    def times(self, factor: float) -> Estimate:
        """Return the estimate in another unit."""
        return Estimate(factor * self.value, abs(factor) * self.sigma)


@dataclass(frozen=True, slots=True)
class FieldQuantities:
    """A displacement field in a few numbers.

    Attributes:
        mean_shear_x_px: Mean displacement along x, px.
        mean_shear_y_px: Mean displacement along y, px.
        torsion_rad: Rotation of the markers about their centre that fits best, rad.
        divergence: Mean growth of area; positive where the skin is spread.
        curl: Mean curl, twice the mean rotation, rad.
        strain: Root mean square of the gradient over the markers. Noise adds to it, and the share
            that is expected is taken off.
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
        gradient = GradientOperator(reference_px)
        self._noise = noise_px
        self._form = gradient.strength_form()
        self._noise2 = 2.0 * noise_px**2 * float(np.trace(self._form))
        self._inertia = float((self._away**2).sum())
        by_x, by_y = gradient.mean_slopes()
        self._of_divergence = np.column_stack([by_x, by_y]).ravel()
        self._of_curl = np.column_stack([-by_y, by_x]).ravel()

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
        return FieldQuantities(
            Estimate(float(mean[0]), of_mean),
            Estimate(float(mean[1]), of_mean),
            torsion,
            self._linear(self._of_divergence, flat),
            self._linear(self._of_curl, flat),
            self._strain(displacement),
        )

    def _strain(self, displacement: Field) -> Estimate:
        """Return the strength without its noise: a root of a sum of squares.

        The sum's variance is that of a quadratic form of normal numbers; a root's deviation is the
        sum's over twice the root, but never over less than the sum's own root, near rest.
        """
        slopes = self._form @ displacement
        strain = np.sqrt(max(float((displacement * slopes).sum()) - self._noise2, 0.0))
        of_noise = 4.0 * self._noise**4 * float((self._form**2).sum())
        # The measured slopes hold twice the noise's own variance, of which one part is wanted.
        variance = 4.0 * self._noise**2 * float((slopes**2).sum()) - of_noise
        deviation = np.sqrt(max(variance, of_noise))
        least = max(strain, np.sqrt(deviation), np.finfo(np.float64).tiny)
        return Estimate(float(strain), float(0.5 * deviation / least))

    def _linear(self, weights: Field, flat: Field) -> Estimate:
        return Estimate(float(weights @ flat), self._noise * float(np.sqrt(weights @ weights)))
