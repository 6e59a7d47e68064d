"""How the skin is deformed: the displacement field, its gradient, and quantities of the whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spikingtac.calibration.lens import marker_pitch_px
from spikingtac.errors import ConfigError
from spikingtac.types import FloatArray

# Markers whose displacements make a gradient, the marker itself included: the 3 by 3 block of a
# square grid, or half of it at the border.
NEIGHBOURS = 9
LEAST_MARKERS = 4  # Fewer markers do not span a gradient with an error to judge it by.

# Root mean square distance from a line, in pitches, up to which markers lie on it: a row's
# places err and bend as much, and it is too little to tell a slope by.
LINE_PITCHES = 0.1

# Share of the largest singular value below which a neighbourhood has no extent: rounding.
LEAST_EXTENT = 1e-9


def straightened(reference: FloatArray) -> FloatArray | None:
    """Return markers ``(m, 2)`` of one row, each moved onto the row's line; None of any others.

    Raises:
        ConfigError: Fewer than two markers.
    """
    middle = reference.mean(axis=0)
    away = reference - middle
    _, extent, axes = np.linalg.svd(away, full_matrices=False)
    if extent[1] > LINE_PITCHES * marker_pitch_px(reference) * np.sqrt(len(reference)):
        return None
    return middle + np.outer(away @ axes[0], axes[0])


class GradientOperator:
    """Local least squares on the nearest markers, precomputed for one sensor.

    Example:
        >>> axes = np.meshgrid(np.arange(4.0), np.arange(4.0))
        >>> place = np.column_stack([axis.ravel() for axis in axes])
        >>> GradientOperator(place).slopes(0.1 * place)[0].round(6).tolist()
        [[0.1, 0.0], [0.0, 0.1]]
    """

    def __init__(self, reference: FloatArray) -> None:
        """Prepare the operator.

        Args:
            reference: ``(m, 2)`` markers at rest, px or mm.

        Raises:
            ConfigError: Too few markers.
        """
        markers = len(reference)
        if markers < LEAST_MARKERS:
            raise ConfigError(
                f"{markers} markers span no field, at least {LEAST_MARKERS} are needed"
            )
        # Of a row only what changes along it is known; its places' errors across it tell nothing.
        row = straightened(reference)
        reference = reference if row is None else row
        self.along = np.zeros((2, markers, markers))
        near = min(NEIGHBOURS, markers)
        self._near = np.zeros((markers, near), np.int64)
        self._slopes = np.zeros((markers, 2, near))
        for marker, place in enumerate(reference):
            away = reference - place
            chosen = np.argsort((away**2).sum(axis=1), kind="stable")[:near]
            rows = np.column_stack([np.ones(near), away[chosen]])
            self._near[marker] = chosen
            self._slopes[marker] = np.linalg.pinv(rows, LEAST_EXTENT)[1:]
            self.along[:, marker, chosen] = self._slopes[marker]

    def slopes(self, displacement: FloatArray) -> FloatArray:
        """Return ``(m, 2, 2)`` derivatives by x and y of each of displacements ``(m, 2)``."""
        return np.matmul(self._slopes, displacement[self._near])

    def strength_of(self, displacement: FloatArray) -> float:
        """Return the root mean square over the markers of the gradient of one field ``(m, 2)``.

        It is the length of divergence, curl, stretch and skew together.
        """
        slopes = self.slopes(displacement)
        return float(np.sqrt(2.0 * (slopes * slopes).sum() / len(slopes)))

    def noise_gain(self) -> float:
        """Return the strength of the gradients of white noise of one px per axis."""
        return float(np.sqrt(4.0 * (self.along**2).sum() / self.along.shape[1]))


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

    def __init__(self, reference_px: FloatArray, noise_px: float) -> None:
        """Prepare the gauge.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px.
            noise_px: Standard deviation of a marker's displacement, per axis, px.

        Raises:
            ConfigError: Too few markers.
        """
        self._away = reference_px - reference_px.mean(axis=0)
        self._noise = noise_px
        by_x, by_y = along = GradientOperator(reference_px).along
        # Quadratic form of the squared strength, for displacements along x and along y alike.
        self._form = 2.0 / len(by_x) * (by_x.T @ by_x + by_y.T @ by_y)
        self._noise2 = 2.0 * noise_px**2 * float(np.trace(self._form))
        self._inertia = float((self._away**2).sum())
        by_x, by_y = along.mean(axis=1)
        self._of_divergence = np.column_stack([by_x, by_y]).ravel()
        self._of_curl = np.column_stack([-by_y, by_x]).ravel()

    def measure(self, displacement: FloatArray) -> FieldQuantities:
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

    def _strain(self, displacement: FloatArray) -> Estimate:
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

    def _linear(self, weights: FloatArray, flat: FloatArray) -> Estimate:
        return Estimate(float(weights @ flat), self._noise * float(np.sqrt(weights @ weights)))


# Deviation that is always believed, as a share of the markers' pitch (1.1 px of 37 px; good
# trackers err by 0.3 px).
LEAST_PITCH_SHARE = 0.03

# Median deviations of the neighbourhood that are believed (3 rejects markers at the rim of a
# dragged punch on the ten scenes).
SPREAD_FACTOR = 4.0

# Frames between two looks: a lost marker stays lost for long, and the look costs most of it.
EVERY = 5

# Share of the deviation that makes a marker lost below which it is believed again (without it
# markers flicker between the two).
FOUND_SHARE = 0.5


class LostMarkers:
    """Replaces the displacements of missing and of lost markers by those of their neighbours.

    A sudden release can leave a tracker on a wrong place, and a few such markers strain the field
    more than a light touch does. An elastic skin moves neighbours alike: a marker that differs from
    the median of its neighbourhood by far more than these differ among themselves is not believed.

    Attributes:
        lost: ``(m,)`` True for the markers that were replaced in the last frame.
    """

    def __init__(self, reference: FloatArray) -> None:
        """Prepare the neighbourhoods of markers ``(m, 2)`` at rest, px or mm.

        Raises:
            ConfigError: Fewer than two markers.
        """
        away = np.sqrt(((reference[:, None] - reference[None]) ** 2).sum(axis=2))
        self._near = np.argsort(away, axis=1, kind="stable")[:, :NEIGHBOURS].T
        self._least = LEAST_PITCH_SHARE * marker_pitch_px(reference)
        self.reset()

    def reset(self) -> None:
        """Believe every marker again."""
        self.lost, self._frame = np.zeros(self._near.shape[1], np.bool_), 0

    def filled(self, displacement: FloatArray, rest: FloatArray, before: FloatArray) -> FloatArray:
        """Return displacements ``(m, 2)`` of which none is missing.

        Args:
            displacement: ``(m, 2)``; rows that are not finite are missing.
            rest: ``(m, 2)`` displacements at rest, from which neighbours move alike.
            before: ``(m, 2)`` of the last frame: a marker all of whose neighbours are missing
                stays where it was.
        """
        there = np.isfinite(displacement[:, 0] + displacement[:, 1])
        if there.all():
            return displacement
        filled = np.where(there[:, None], displacement, before)
        for marker in np.flatnonzero(~there):
            near = self._near[:, marker]
            near = near[there[near]]
            if len(near):
                filled[marker] = rest[marker] + np.median(filled[near] - rest[near], axis=0)
        return filled

    def repaired(self, displacement: FloatArray) -> FloatArray:
        """Return displacements ``(m, 2)`` of which the lost ones are replaced."""
        if self._frame % EVERY == 0:
            around = displacement[self._near]
            median = middle_of(around)
            believed = SPREAD_FACTOR * middle_of(np.abs(around - median)) + self._least
            off = (np.abs(displacement - median) / believed).max(axis=1)
            self.lost = off > np.where(self.lost, FOUND_SHARE, 1.0)
        self._frame += 1
        if not self.lost.any():
            return displacement
        out = displacement.copy()
        out[self.lost] = middle_of(displacement[self._near[:, self.lost]])
        return out


def middle_of(values: FloatArray) -> FloatArray:
    """Return the upper median along the first axis."""
    return np.partition(values, len(values) // 2, axis=0)[len(values) // 2]


def spread_of(away: FloatArray, share: float) -> tuple[float, float]:
    """Return the largest displacement, and within which distance of the common one a share lies.

    Args:
        away: ``(m, 2)`` displacements; the common one is their median, axis by axis.
        share: Share of the markers, below 1.
    """
    square, rank = ((away - middle_of(away)) ** 2).sum(axis=1), int(share * len(away))
    largest = float(np.sqrt((away**2).sum(axis=1).max()))
    return largest, float(np.sqrt(np.partition(square, rank)[rank]))
