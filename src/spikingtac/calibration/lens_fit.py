"""Fit a lens to the rests of a flat grid: where they are uneven, it distorts or is tilted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.lens import LARGEST_RADIAL, Lens, projected, undistorted
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError

PARAMETERS = 9
"""Eight of the homography, one of the lens."""
FEWEST_MARKERS = 12
"""Twice as many numbers as are sought, and half of them again (ours)."""
LARGEST_DOUBT = 0.01
"""Standard error of the scale at the outermost marker up to which a lens is believed (ours)."""


def with_lens(calibration: Calibration, pitch_mm: float, *, staggered: bool = False) -> Calibration:
    """Return a calibration with its lens, or with the reason why there is none in its provenance.

    Args:
        calibration: Of a flat grid.
        pitch_mm: Distance of neighbouring markers on the skin, mm.
        staggered: Whether every second row is shifted, so that columns are not straight.
    """
    rest_px, grid = calibration.reference_px, calibration.grid
    try:
        if grid is None or staggered:
            raise CalibrationError("without rows and columns nothing is known to be even")
        lens = fit_lens(rest_px, grid, calibration.size, pitch_mm, calibration.marker_measured)
    except CalibrationError as error:
        return replace(calibration, provenance={**calibration.provenance, "no_lens": str(error)})
    return replace(calibration, lens=lens)


def fit_lens(
    reference_px: NDArray[np.float64],
    grid: tuple[int, int],
    size: tuple[int, int],
    pitch_mm: float,
    measured: NDArray[np.bool_] | None = None,
) -> Lens:
    """Return the lens that shows an even grid as these rests.

    Args:
        reference_px: ``(m, 2)`` rests of a flat grid, row by row, px.
        grid: ``(rows, columns)``.
        size: ``(width, height)`` of the sensor, px.
        pitch_mm: Distance of neighbouring markers on the skin, mm.
        measured: ``(m,)`` which of them were measured; None is all.

    Raises:
        CalibrationError: The grid is too small, or too uneven itself, to show a lens.
    """
    from scipy.optimize import least_squares

    used = np.ones(len(reference_px), bool) if measured is None else measured
    _refuse_few(int(np.count_nonzero(used)), grid)
    y, x = np.mgrid[0 : grid[0], 0 : grid[1]].astype(np.float64) * pitch_mm
    ideal_mm = np.stack([x.ravel() - x.mean(), y.ravel() - y.mean()], axis=1)[used]
    center_px, half_px = ((size[0] - 1) / 2, (size[1] - 1) / 2), float(np.hypot(*size)) / 2
    scaled = (reference_px[used] - center_px) / half_px

    def off_mm(values: NDArray[np.float64]) -> NDArray[np.float64]:
        place = projected(_homography(values), undistorted(scaled, values[-1]))
        return (place - ideal_mm).ravel()

    affine = np.linalg.lstsq(np.column_stack([scaled, np.ones(len(scaled))]), ideal_mm, rcond=None)
    start = np.concatenate([affine[0].T.ravel(), [0.0, 0.0, 0.0]])
    bound = np.full(PARAMETERS, np.inf)
    bound[-1] = LARGEST_RADIAL
    found = least_squares(off_mm, start, bounds=(-bound, bound), x_scale="jac")
    variance = (found.fun**2).sum() / (len(found.fun) - PARAMETERS)
    spread = variance * np.linalg.pinv(found.jac.T @ found.jac)
    radial, sigma = float(found.x[-1]), float(np.sqrt(spread[-1, -1]))
    _refuse_doubt(sigma, scaled)
    return Lens(
        center_px=center_px,
        half_diagonal_px=half_px,
        radial=radial,
        radial_sigma=sigma,
        homography=_upright(_homography(found.x)),
        residual_mm=float(np.sqrt((found.fun**2).mean())),
    )


def rim_share(radial: float, scaled: NDArray[np.float64]) -> float:
    """Return by which share a coefficient changes the scale at the outermost of some places.

    The radial scale of the division model is (1 - k s^2) / (1 + k s^2)^2, near 1 - 3 k s^2.
    """
    return 3.0 * radial * float((scaled**2).sum(axis=1).max())


def _refuse_few(markers: int, grid: tuple[int, int]) -> None:
    if min(grid) < 3 or markers < FEWEST_MARKERS:
        raise CalibrationError(
            f"{markers} markers in {grid[0]}x{grid[1]} do not show a lens; at least "
            f"{FEWEST_MARKERS} in three rows and columns are needed"
        )


def _refuse_doubt(sigma: float, scaled: NDArray[np.float64]) -> None:
    doubt = rim_share(sigma, scaled)
    if not doubt <= LARGEST_DOUBT:
        raise CalibrationError(
            f"the grid does not show the lens: the scale at its rim would be uncertain by "
            f"{100 * doubt:.1f} % (at most {100 * LARGEST_DOUBT:g} % is accepted); the markers are "
            "placed too unevenly, cover too little of the image, or were calibrated on a skin that "
            "is not flat"
        )


def _homography(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.append(values[:8], 1.0).reshape(3, 3)


def _upright(homography: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return it with the skin's axes along those of the image at the centre, not of the grid."""
    middle, fall = homography[:2, 2], homography[2, :2]
    slope = homography[:2, :2] - np.outer(middle, fall)  # d mm / d u at u = 0
    left, _, right = np.linalg.svd(slope)
    turn = np.eye(3)
    turn[:2, :2] = (left @ right).T
    return turn @ homography
