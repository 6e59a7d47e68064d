"""From the image to the flat skin: the pitch of the markers, and the lens where it distorts.

One radial coefficient by the division model, u = s / (1 + k s^2) (Fitzgibbon, CVPR 2001), where s
is the place relative to the image's centre over half of its diagonal; then a homography from u to
the skin.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.document import LARGEST_RADIAL, checked_lens
from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.types import FloatArray


@dataclass(frozen=True, kw_only=True, slots=True)
class Lens:
    """Projection of a pixel onto the flat skin.

    Attributes:
        center_px: ``(x, y)`` centre of the distortion: the sensor's centre.
        half_diagonal_px: Distance at which s is 1.
        radial: The coefficient k; negative for a barrel.
        radial_sigma: Its standard error.
        homography: ``(3, 3)`` from (u, 1) to the skin, mm; its axes are those of the image.
        residual_mm: Root mean square residual of the grid's markers in x and y, mm.
    """

    center_px: tuple[float, float]
    half_diagonal_px: float
    radial: float
    radial_sigma: float
    homography: FloatArray
    residual_mm: float

    def to_mm(self, place_px: NDArray[np.floating]) -> FloatArray:
        """Return places ``(..., 2)`` on the flat skin, mm, of places ``(..., 2)`` on the image."""
        scaled = (place_px.astype(np.float64) - self.center_px) / self.half_diagonal_px
        return projected(self.homography, undistorted(scaled, self.radial))

    def scaled(self, factor: float) -> Self:
        """Return the same lens over a skin that is larger by a factor."""
        homography = np.diag([factor, factor, 1.0]) @ self.homography
        return replace(self, homography=homography, residual_mm=factor * self.residual_mm)

    def document(self) -> dict[str, Any]:
        """Return it as JSON, for calibrations and tracks."""
        return {**asdict(self), "homography": self.homography.tolist()}

    @classmethod
    def from_document(cls, document: Any) -> Self:
        """Build it from parsed JSON.

        Raises:
            KeyError: A key is missing.
            TypeError: A value is of another kind.
            ValueError: A value is unfit.
        """
        return cls(**checked_lens(document))


def undistorted(scaled: FloatArray, radial: float) -> FloatArray:
    """Return places as a lens without distortion would show them; all relative to the centre."""
    return scaled / (1.0 + radial * (scaled**2).sum(axis=-1, keepdims=True))


def projected(homography: FloatArray, place: FloatArray) -> FloatArray:
    """Return places ``(..., 2)`` under a homography ``(3, 3)``."""
    moved = place @ homography[:, :2].T + homography[:, 2]
    return moved[..., :2] / moved[..., 2:]


PARAMETERS = 9  # Eight of the homography, one of the lens.
FEWEST_MARKERS = 12  # 24 coordinates for 9 parameters.

# Largest accepted standard error of the scale at the outermost marker.
LARGEST_DOUBT = 0.01


def fit_lens(
    reference_px: FloatArray,
    grid: tuple[int, int],
    size: tuple[int, int],
    pitch_mm: float,
    measured: NDArray[np.bool_] | None = None,
) -> Lens:
    """Fit a lens to the image of a regular grid.

    Args:
        reference_px: ``(m, 2)`` rest positions of a flat grid, row by row, px.
        grid: ``(rows, columns)``.
        size: ``(width, height)`` of the sensor, px.
        pitch_mm: Distance of neighbouring markers on the skin, mm.
        measured: ``(m,)`` which of them were measured; None is all.

    Raises:
        CalibrationError: The grid is too small, or too uneven itself, to show a lens.
    """
    used = np.ones(len(reference_px), bool) if measured is None else measured
    if min(grid) < 3 or np.count_nonzero(used) < FEWEST_MARKERS:
        raise CalibrationError(
            f"{np.count_nonzero(used)} markers in {grid[0]}x{grid[1]} do not show a lens; at least "
            f"{FEWEST_MARKERS} in three rows and columns are needed"
        )
    y, x = np.mgrid[0 : grid[0], 0 : grid[1]].astype(np.float64) * pitch_mm
    ideal_mm = np.stack([x.ravel() - x.mean(), y.ravel() - y.mean()], axis=1)[used]
    center_px, half_px = ((size[0] - 1) / 2, (size[1] - 1) / 2), float(np.hypot(*size)) / 2
    scaled = (reference_px[used] - center_px) / half_px
    values, sigma, residual_mm = _solved(scaled, ideal_mm)
    # The radial scale of the division model is (1 - k s^2) / (1 + k s^2)^2, near 1 - 3 k s^2.
    doubt = 3.0 * sigma * float((scaled**2).sum(axis=1).max())
    if not doubt <= LARGEST_DOUBT:
        raise CalibrationError(
            f"the grid does not show the lens: the scale at its rim would be uncertain by "
            f"{100 * doubt:.1f} % (at most {100 * LARGEST_DOUBT:g} % is accepted); the markers are "
            "placed too unevenly, cover too little of the image, or were calibrated on a skin that "
            "is not flat"
        )
    return Lens(
        center_px=center_px,
        half_diagonal_px=half_px,
        radial=float(values[-1]),
        radial_sigma=sigma,
        homography=_upright(_homography(values)),
        residual_mm=residual_mm,
    )


def _solved(scaled: FloatArray, ideal_mm: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the parameters, the standard error of the radial one, and the rms residual, mm."""
    from scipy.optimize import least_squares

    def off_mm(values: FloatArray) -> FloatArray:
        place = projected(_homography(values), undistorted(scaled, values[-1]))
        return (place - ideal_mm).ravel()

    affine = np.linalg.lstsq(np.column_stack([scaled, np.ones(len(scaled))]), ideal_mm, rcond=None)
    start = np.concatenate([affine[0].T.ravel(), [0.0, 0.0, 0.0]])
    bound = np.full(PARAMETERS, np.inf)
    bound[-1] = LARGEST_RADIAL
    found = least_squares(off_mm, start, bounds=(-bound, bound), x_scale="jac")
    variance = (found.fun**2).sum() / (len(found.fun) - PARAMETERS)
    spread = variance * np.linalg.pinv(found.jac.T @ found.jac)
    return found.x, float(np.sqrt(spread[-1, -1])), float(np.sqrt((found.fun**2).mean()))


def _homography(values: FloatArray) -> FloatArray:
    return np.append(values[:8], 1.0).reshape(3, 3)


def _upright(homography: FloatArray) -> FloatArray:
    """Return it with the skin's axes along those of the image at the centre, not of the grid."""
    middle, fall = homography[:2, 2], homography[2, :2]
    slope = homography[:2, :2] - np.outer(middle, fall)  # d mm / d u at u = 0
    left, _, right = np.linalg.svd(slope)
    turn = np.eye(3)
    turn[:2, :2] = (left @ right).T
    return turn @ homography


HALF_STEP_PX = 0.5  # Half the step of the difference quotient for a local scale.


@dataclass(frozen=True, slots=True)
class SkinScale:
    """Places on the image as places on the flat skin.

    Attributes:
        px_per_mm: The mean scale.
        lens: Where each pixel looks, or None: the mean scale stands for all of them.
    """

    px_per_mm: float
    lens: Lens | None = None

    @classmethod
    def of(cls, px_per_mm: float | None, lens: Any) -> Self | None:
        """Return the scale of a file that may know none, its lens as parsed JSON or None.

        Raises:
            KeyError, TypeError, ValueError: The lens is damaged.
        """
        known = None if lens is None else Lens.from_document(lens)
        return None if px_per_mm is None else cls(px_per_mm, known)

    def to_mm(self, place_px: NDArray[np.floating]) -> FloatArray:
        """Return places ``(..., 2)`` of the skin, mm, of places ``(..., 2)`` of the image.

        The axes are those of the image. With a lens, the image's centre is where the mean scale
        has it.
        """
        if self.lens is None:
            return place_px / np.float64(self.px_per_mm)
        center_px = np.array(self.lens.center_px)
        return self.lens.to_mm(place_px) - self.lens.to_mm(center_px) + center_px / self.px_per_mm

    def mm_per_px(self, place_px: NDArray[np.floating]) -> float:
        """Return the scale at one position ``(2,)``: the square root of a pixel's area, mm."""
        if self.lens is None:
            return 1.0 / self.px_per_mm
        ways_px = HALF_STEP_PX * np.eye(2)
        across_mm = self.lens.to_mm(place_px + ways_px) - self.lens.to_mm(place_px - ways_px)
        return float(np.sqrt(abs(np.linalg.det(across_mm)))) / (2.0 * HALF_STEP_PX)


FEWEST_NEIGHBOURS = 2  # Fewer markers have no pitch.

# Markers up to this many times the distance of the nearest one are neighbours: the other axis of
# a rectangular grid is, the diagonal of a square one is not.
NEIGHBOUR_SHARE = 1.25


def marker_pitch_px(reference_px: FloatArray) -> float:
    """Return the median distance of markers ``(m, 2)`` from their nearest neighbours, px.

    Raises:
        ConfigError: There are fewer than two markers.
    """
    return float(np.median(_neighbour_distances_px(reference_px).min(axis=1)))


def mean_pitch_px(reference_px: FloatArray) -> float:
    """Return the mean distance of all neighbours among markers ``(m, 2)``, px.

    Raises:
        ConfigError: There are fewer than two markers.
    """
    away_px = _neighbour_distances_px(reference_px)
    nearest_px = away_px.min(axis=1)
    reach_px = NEIGHBOUR_SHARE * np.minimum(nearest_px[:, None], nearest_px)
    return float(away_px[away_px <= np.maximum(reach_px, nearest_px[:, None])].mean())


def _neighbour_distances_px(reference_px: FloatArray) -> FloatArray:
    if len(reference_px) < FEWEST_NEIGHBOURS:
        raise ConfigError(
            f"{len(reference_px)} marker has no pitch, at least {FEWEST_NEIGHBOURS} are needed"
        )
    return distances_px(reference_px)


def distances_px(reference_px: FloatArray) -> FloatArray:
    """Return ``(m, m)`` distances of markers ``(m, 2)`` from each other, infinite from itself."""
    away_px = np.hypot(*(reference_px[:, np.newaxis] - reference_px).transpose(2, 0, 1))
    np.fill_diagonal(away_px, np.inf)
    return away_px
