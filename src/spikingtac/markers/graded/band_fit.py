"""Fit a disc's centre to the levels at which pixels fired, and to the bands of those that did not.

A pixel that fired since the last estimate was at its level then: residual e = M - S(|x - c| - r)
with the variance of M. A pixel that did not fire lies in its band: it says something only where the
disc asks for a level outside of it, and then by how much. Both pull at the predicted centre, whose
variance is given, by a few Gauss-Newton steps (a maximum a posteriori estimate). Then each level is
corrected towards the fitted disc by its Kalman gain, so that thresholds that differ between pixels
do not add up. Ours; the idea of one state for pose and brightness is that of event-based mosaicing
(Kim et al. 2014, doi:10.5244/C.28.26).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.graded.motion import (
    AGREEMENT,
    AT_US,
    PP,
    PV,
    VV,
    VX,
    VY,
    X,
    Y,
    predict_kernel,
    rest_kernel,
)
from spikingtac.state_map.graded import PAD_PX

# Variance of a disc's own level, shares of a swing squared: profiles are never exact.
MODEL_VARIANCE = 0.003

LARGEST_STEP_PX = 1.0  # A Gauss-Newton step is cut to this length.

SMALL_STEP_PX = 0.005  # A fit whose last step was shorter has converged.

# Residual at which a pixel counts half (Cauchy). Sharper, 3 standard deviations, is 3 % more
# accurate on presses and loses markers that snap back at 2,000 px/s (measured, simulated).
SOFT_RESIDUAL = 0.4

ITERATIONS = 3  # Gauss-Newton steps per marker and estimate at most.

BAND_WEIGHT = 0.4  # Weight of a pixel that did not fire, over that of one that did.

MOST_GAIN = 0.3  # Largest share of a level's disagreement that one estimate corrects.

# Residual of an expected level at which a pixel counts half as agreeing, as in the disc fit.
SOFT_LEVEL = 0.8


@njit(cache=True, nogil=True, error_model="numpy")
def _window_kernel(
    x: float, y: float, reach_px: float, width: int, height: int
) -> tuple[int, int, int, int]:  # pragma: no cover - compiled
    """Return first and last column, first and last row of the pixels around a place."""
    return (
        max(0, int(np.ceil(x - reach_px))),
        min(width - 1, int(np.floor(x + reach_px))),
        max(0, int(np.ceil(y - reach_px))),
        min(height - 1, int(np.floor(y + reach_px))),
    )


@njit(cache=True, nogil=True)
def _any_fired_kernel(
    fired: NDArray[np.int64], turn: int, window: tuple[int, int, int, int]
) -> bool:  # pragma: no cover - compiled
    for row in range(window[2], window[3] + 1):
        for column in range(window[0], window[1] + 1):
            if fired[row, column] == turn:
                return True
    return False


@njit(cache=True, nogil=True)
def _residual_kernel(
    apart: float, new: bool, steps: NDArray[np.float32]
) -> float:  # pragma: no cover - compiled
    """Return how far a level is from a disc's: all of it where it is new, else beyond its band.

    ``steps`` are the pixel's falling (negative) and rising step: a level may lie above the disc's
    by an OFF step, and below by an ON step, without an event.
    """
    if new:
        return apart
    return max(apart + steps[0], 0.0) + min(apart + steps[1], 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _normal_equations_kernel(
    maps: tuple[Any, ...],
    disc: tuple[float, float, float, float],
    table: NDArray[np.float32],
    sums: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Sum curvature (xx, xy, yy) and gradient (x, y) of the pixels around a disc.

    ``maps`` are those of :func:`fit_bands_kernel`; ``disc`` is x, y, radius and the table's reach,
    px.
    """
    memory, variance, fired, steps, turn, _ = maps
    x, y, radius_px, reach_px = disc
    height, width = memory.shape
    last = table.shape[1] - 1
    scale = 0.5 * last / reach_px
    farthest = radius_px + reach_px
    sums[:] = 0.0
    window = _window_kernel(x, y, farthest, width, height)
    for row in range(window[2], window[3] + 1):
        for column in range(window[0], window[1] + 1):
            dx, dy = column - x, row - y
            rho = np.sqrt(dx * dx + dy * dy) + 1e-9
            place = (rho - radius_px + reach_px) * scale
            if place < 0.0 or place >= last:
                continue
            entry = int(place)
            new = fired[row, column] == turn
            e = _residual_kernel(memory[row, column] - table[0, entry], new, steps[row, column])
            if e == 0.0:
                continue
            weight = (1.0 if new else BAND_WEIGHT) / (variance[row, column] + MODEL_VARIANCE)
            weight /= 1.0 + e * e / SOFT_RESIDUAL**2
            slope = -table[2, entry]
            jx, jy = slope * dx / rho, slope * dy / rho
            sums[0] += weight * jx * jx
            sums[1] += weight * jx * jy
            sums[2] += weight * jy * jy
            sums[3] += weight * jx * e
            sums[4] += weight * jy * e


@njit(cache=True, nogil=True, error_model="numpy")
def _correct_levels_kernel(
    maps: tuple[Any, ...],
    disc: tuple[float, float, float, float],
    table: NDArray[np.float32],
    center_variance: float,
) -> float:  # pragma: no cover - compiled
    """Draw levels towards the fitted disc; return the share of its edge that agrees with them."""
    memory, variance, fired, steps, turn, padded = maps
    x, y, radius_px, reach_px = disc
    height, width = memory.shape
    last = table.shape[1] - 1
    scale = 0.5 * last / reach_px
    agreeing, total = 0.0, 1e-6
    window = _window_kernel(x, y, radius_px + reach_px, width, height)
    for row in range(window[2], window[3] + 1):
        for column in range(window[0], window[1] + 1):
            place = (np.hypot(column - x, row - y) - radius_px + reach_px) * scale
            if place < 0.0 or place >= last:
                continue
            entry = int(place)
            slope = -table[2, entry]
            apart = (padded[row + PAD_PX, column + PAD_PX] - table[0, entry]) / SOFT_LEVEL
            agreeing += slope / (1.0 + apart * apart)
            total += slope
            new = fired[row, column] == turn
            e = _residual_kernel(memory[row, column] - table[0, entry], new, steps[row, column])
            if e == 0.0:
                continue
            known = variance[row, column]
            gain = known / (known + MODEL_VARIANCE + slope * slope * center_variance)
            gain = min(gain, MOST_GAIN) / (1.0 + e * e / SOFT_RESIDUAL**2)
            memory[row, column] -= np.float32(gain * e)
            padded[row + PAD_PX, column + PAD_PX] -= np.float32(gain * e)
            if new:
                variance[row, column] = np.float32(known * (1.0 - gain))
    return agreeing / total


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_kernel(
    sums: NDArray[np.float64], away: tuple[float, float], prior: float
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Return the Gauss-Newton step in x and y, px, and the variance of the place, px^2.

    ``away`` leads to the predicted place, ``prior`` is its variance.
    """
    xx, xy, yy = sums[0] + 1.0 / prior, sums[1], sums[2] + 1.0 / prior
    gx, gy = sums[3] + away[0] / prior, sums[4] + away[1] / prior
    determinant = xx * yy - xy * xy
    step_x, step_y = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
    return step_x, step_y, 0.5 * (xx + yy) / determinant


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_one_kernel(
    maps: tuple[Any, ...],
    motion: NDArray[np.float64],
    disc: tuple[float, float, NDArray[np.float32]],
    sums: NDArray[np.float64],
) -> float:  # pragma: no cover - compiled
    """Correct one marker's predicted state, then the levels around it; return the agreement.

    ``disc`` is the radius and the table's reach, px, and the table.
    """
    radius_px, reach_px, table = disc
    px, py, prior = motion[X], motion[Y], motion[PP]
    x, y, posterior = px, py, prior
    for _ in range(ITERATIONS):
        _normal_equations_kernel(maps, (x, y, radius_px, reach_px), table, sums)
        step_x, step_y, posterior = _solve_kernel(sums, (px - x, py - y), prior)
        length = np.hypot(step_x, step_y)
        share = LARGEST_STEP_PX / max(length, LARGEST_STEP_PX)
        x, y = x + share * step_x, y + share * step_y
        if length < SMALL_STEP_PX:
            break
    gain, speed_gain = max(1.0 - posterior / prior, 0.0), motion[PV] / prior
    motion[X], motion[Y] = x, y
    motion[VX] += speed_gain * (x - px)
    motion[VY] += speed_gain * (y - py)
    motion[VV] -= speed_gain * gain * motion[PV]
    motion[PP], motion[PV] = posterior, (1.0 - gain) * motion[PV]
    return _correct_levels_kernel(maps, (x, y, radius_px, reach_px), table, posterior)


@njit(cache=True, nogil=True, error_model="numpy")
def fit_bands_kernel(
    maps: tuple[Any, ...],
    states: tuple[Any, ...],
    discs: tuple[Any, ...],
    t_us: int,
) -> None:  # pragma: no cover - compiled
    """Move every marker near which pixels fired, and correct the levels around it.

    Args:
        maps: Memory, variance, fired, signed steps, the turn, and the padded expected levels of
            :class:`~spikingtac.state_map.bands.BandStateMap`; the levels are changed.
        states: Motions and fits (:mod:`spikingtac.markers.graded.motion`), of which the agreement
            is kept where nothing fired; and which markers are held, whose motion stays. Changed.
        discs: ``(m,)`` radii at rest, px; values and reaches of
            :func:`~spikingtac.markers.graded.appearance.profile_tables`.
        t_us: The time, us.
    """
    fired, turn = maps[2], maps[4]
    motions, fits, coasted = states
    radius_px, tables, reach_px = discs
    height, width = fired.shape
    sums, start = np.zeros(5), np.zeros(8)
    for m in range(radius_px.size):
        motion = motions[m]
        dt_s = (t_us - motion[AT_US]) * 1e-6 if motion[AT_US] >= 0.0 else 0.0
        motion[AT_US] = t_us
        for k in range(8):
            start[k] = motion[k]
        predict_kernel(motion, dt_s)
        window = _window_kernel(motion[X], motion[Y], radius_px[m] + reach_px[m], width, height)
        if _any_fired_kernel(fired, turn, window):
            disc = radius_px[m], reach_px[m], tables[m]
            fits[m, AGREEMENT] = _fit_one_kernel(maps, motion, disc, sums)
        else:
            motion[X], motion[Y] = start[X], start[Y]
            rest_kernel(motion, dt_s)
        fits[m, 0], fits[m, 1] = motion[X], motion[Y]
        if coasted[m]:
            motion[X], motion[Y], motion[VX], motion[VY] = start[X], start[Y], 0.0, 0.0
