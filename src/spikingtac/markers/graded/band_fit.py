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

from spikingtac.state_map.graded import PAD_PX

MODEL_VARIANCE = 0.003
"""Variance of a disc's own level, shares of a swing squared: profiles are never exact."""

LARGEST_STEP_PX = 1.0
"""A Gauss-Newton step is cut to this length."""

SMALL_STEP_PX = 0.005
"""A fit whose last step was shorter has converged."""

SOFT_RESIDUAL = 0.4
"""Residual at which a pixel counts half (Cauchy). Sharper, 3 standard deviations, is 3 % more
accurate on presses and loses markers that snap back at 2,000 px/s (measured, simulated)."""

SOFT_LEVEL = 0.8
"""Residual of an expected level at which a pixel counts half as agreeing, as in the disc fit."""


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


@njit(cache=True, nogil=True, error_model="numpy")
def _normal_equations_kernel(
    maps: tuple[Any, ...],
    disc: tuple[float, float, float, float],
    table: NDArray[np.float32],
    band_weight: float,
    sums: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Sum curvature (xx, xy, yy) and gradient (x, y) of all pixels around a disc.

    ``maps`` are those of :func:`fit_bands_kernel`; ``disc`` is x, y, radius and the table's reach,
    px.
    """
    memory, variance, fired, steps, turn, _ = maps
    x, y, radius_px, reach_px = disc
    height, width = memory.shape
    last = table.shape[1] - 1
    scale = 0.5 * last / reach_px
    farthest = radius_px + reach_px
    for k in range(5):
        sums[k] = 0.0
    first_column, last_column, first_row, last_row = _window_kernel(x, y, farthest, width, height)
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            dx, dy = column - x, row - y
            rho = np.sqrt(dx * dx + dy * dy) + 1e-9
            place = (rho - radius_px + reach_px) * scale
            if place < 0.0 or place >= last:
                continue
            entry = int(place)
            e = memory[row, column] - table[0, entry]
            weight = 1.0 / (variance[row, column] + MODEL_VARIANCE)
            if fired[row, column] != turn:
                # Above by more than an OFF step, or below by more than an ON step.
                e = max(e + steps[row, column, 0], 0.0) + min(e + steps[row, column, 1], 0.0)
                weight *= band_weight
            if e == 0.0:
                continue
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
    most_gain: float,
) -> float:  # pragma: no cover - compiled
    """Draw levels towards the fitted disc; return the share of its edge that agrees with them."""
    memory, variance, fired, steps, turn, padded = maps
    x, y, radius_px, reach_px = disc
    height, width = memory.shape
    last = table.shape[1] - 1
    scale = 0.5 * last / reach_px
    agreeing, total = 0.0, 1e-6
    first_column, last_column, first_row, last_row = _window_kernel(
        x, y, radius_px + reach_px, width, height
    )
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            dx, dy = column - x, row - y
            place = (np.sqrt(dx * dx + dy * dy) - radius_px + reach_px) * scale
            if place < 0.0 or place >= last:
                continue
            entry = int(place)
            slope = -table[2, entry]
            apart = (padded[row + PAD_PX, column + PAD_PX] - table[0, entry]) / SOFT_LEVEL
            agreeing += slope / (1.0 + apart * apart)
            total += slope
            e = memory[row, column] - table[0, entry]
            new = fired[row, column] == turn
            if not new:
                e = max(e + steps[row, column, 0], 0.0) + min(e + steps[row, column, 1], 0.0)
            if e == 0.0:
                continue
            known = variance[row, column]
            gain = known / (known + MODEL_VARIANCE + slope * slope * center_variance)
            gain = min(gain, most_gain) / (1.0 + e * e / SOFT_RESIDUAL**2)
            memory[row, column] -= np.float32(gain * e)
            padded[row + PAD_PX, column + PAD_PX] -= np.float32(gain * e)
            if new:
                variance[row, column] = np.float32(known * (1.0 - gain))
    return agreeing / total


@njit(cache=True, nogil=True)
def _predict_kernel(
    motion: NDArray[np.float64], dt_s: float, noise_px2_s3: float
) -> None:  # pragma: no cover - compiled
    """Move one marker's state on: x, y, vx, vy, and the variances (pp, pv, vv) of each axis."""
    pp, pv, vv = motion[4], motion[5], motion[6]
    motion[0] += dt_s * motion[2]
    motion[1] += dt_s * motion[3]
    motion[4] = pp + dt_s * (2.0 * pv + dt_s * vv) + noise_px2_s3 * dt_s**3 / 3.0
    motion[5] = pv + dt_s * vv + 0.5 * noise_px2_s3 * dt_s**2
    motion[6] = vv + noise_px2_s3 * dt_s


@njit(cache=True, nogil=True)
def _hold_kernel(
    motion: NDArray[np.float64], dt_s: float, settings: tuple[float, float, float]
) -> None:  # pragma: no cover - compiled
    """Let one marker rest where it is, since nothing fired: its speed fades, its variance grows."""
    stop_s, most_pp, most_vv = settings
    kept = np.exp(-dt_s / stop_s)
    motion[2] *= kept
    motion[3] *= kept
    motion[4] = min(motion[4], most_pp)
    motion[5] = 0.0
    motion[6] = min(motion[6], most_vv)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_one_kernel(
    maps: tuple[Any, ...],
    motion: NDArray[np.float64],
    disc: tuple[float, float],
    table: NDArray[np.float32],
    settings: tuple[float, float, int],
    sums: NDArray[np.float64],
) -> float:  # pragma: no cover - compiled
    """Correct one marker's predicted state, then the levels around it; return the agreement."""
    radius_px, reach_px = disc
    band_weight, most_gain, iterations = settings
    px, py, prior = motion[0], motion[1], motion[4]
    x, y, posterior = px, py, prior
    for _ in range(iterations):
        _normal_equations_kernel(maps, (x, y, radius_px, reach_px), table, band_weight, sums)
        xx, xy, yy = sums[0] + 1.0 / prior, sums[1], sums[2] + 1.0 / prior
        gx, gy = sums[3] + (px - x) / prior, sums[4] + (py - y) / prior
        determinant = xx * yy - xy * xy
        step_x, step_y = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
        posterior = 0.5 * (xx + yy) / determinant
        length = np.hypot(step_x, step_y)
        share = LARGEST_STEP_PX / max(length, LARGEST_STEP_PX)
        x, y = x + share * step_x, y + share * step_y
        if length < SMALL_STEP_PX:
            break
    gain, speed_gain = max(1.0 - posterior / prior, 0.0), motion[5] / prior
    motion[0], motion[1] = x, y
    motion[2] += speed_gain * (x - px)
    motion[3] += speed_gain * (y - py)
    motion[6] -= speed_gain * gain * motion[5]
    motion[4], motion[5] = posterior, (1.0 - gain) * motion[5]
    return _correct_levels_kernel(maps, (x, y, radius_px, reach_px), table, posterior, most_gain)


@njit(cache=True, nogil=True, error_model="numpy")
def fit_bands_kernel(
    maps: tuple[Any, ...],
    motion: NDArray[np.float64],
    dt_s: float,
    discs: tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float64]],
    filtering: tuple[float, float, float, float],
    fitting: tuple[float, float, int],
    agreement: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Move every marker near which pixels fired, and correct the levels around it.

    Args:
        maps: Memory, variance, fired, signed steps, the turn, and the padded expected levels of
            :class:`~spikingtac.state_map.bands.BandStateMap`; the levels are changed.
        motion: ``(m, 7)`` x, y (px), vx, vy (px/s), and the variances of place, of place and
            speed, and of speed, the same for both axes; changed.
        dt_s: Time since the last call, s.
        discs: ``(m,)`` radii, px; values and reaches of `profile_tables.ProfileTables`.
        filtering: Noise density of the acceleration, px^2/s^3; time in which the speed of a marker
            fades near which nothing fires, s; its largest variances of place and speed.
        fitting: Weight of a pixel that did not fire; largest gain of a level; Gauss-Newton steps
            at most.
        agreement: ``(m,)`` result: share of the edge that agrees with the map, 0 to 1; kept where
            nothing fired.
    """
    fired, turn = maps[2], maps[4]
    radius_px, tables, reach_px = discs
    height, width = fired.shape
    sums = np.zeros(5)
    for m in range(motion.shape[0]):
        x, y = motion[m, 0], motion[m, 1]
        _predict_kernel(motion[m], dt_s, filtering[0])
        window = _window_kernel(
            motion[m, 0], motion[m, 1], radius_px[m] + reach_px[m], width, height
        )
        if _any_fired_kernel(fired, turn, window):
            disc = (radius_px[m], reach_px[m])
            agreement[m] = _fit_one_kernel(maps, motion[m], disc, tables[m], fitting, sums)
        else:
            motion[m, 0], motion[m, 1] = x, y
            _hold_kernel(motion[m], dt_s, filtering[1:])
