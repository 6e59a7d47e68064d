"""Fit discs to the levels at which pixels fired last."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.disc_levels import (
    INSIDE_EDGES,
    LEVEL_VARIANCE,
    MARGIN_PX,
    OUTSIDE_EDGES,
    REACH_EDGES,
    TABLE_STEPS,
    bounds_kernel,
    crowded_kernel,
    nearer_kernel,
)

ITERATIONS = 3
"""Gauss-Newton steps at each sample: the markers move by less than a pixel between two."""

LARGEST_STEP_PX = 1.5
"""Bound of one Gauss-Newton step."""

RESIDUAL_LEVEL = 0.3
"""Residuals beyond this level count less (Cauchy weights)."""

IN_BAND_WEIGHT = 0.6
"""A level inside of its band counts less than one outside of it."""

AGREEING_LEVEL = 0.35
"""A pixel agrees with the disc within this level."""

SMALL_STEP_PX = 0.01
"""A fit ends after a smaller step."""

Scene = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float32]]
"""What a fit knows of all discs: places, nearest others, shapes and ``fit_tables``."""


@njit(cache=True)
def read_kernel(z: Any, table: NDArray[np.float32]) -> tuple[float, float]:
    """Return level and fall per edge width at ``z`` edge widths outside of the rim, from a table.

    The formula itself, :func:`~spikingtac.markers.calibration.disc_levels.profile_kernel`, takes
    twice as long.
    """
    place = (z + REACH_EDGES) * ((TABLE_STEPS - 1) / (2.0 * REACH_EDGES))
    if place >= TABLE_STEPS - 1:
        return 0.0, 0.0
    if place <= 0.0:
        return 1.0, 0.0
    cell = int(place)
    share = place - cell
    level, fall = table[cell, 0], table[cell, 1]
    return level + share * (table[cell + 1, 0] - level), fall + share * (table[cell + 1, 1] - fall)


@njit(cache=True)
def residual_kernel(band: tuple[Any, Any, Any, Any], expected: Any) -> tuple[float, float]:
    """Return how far a pixel's light probably lies above the expected level, and the weight of it.

    ``band`` is the level at which the pixel fired last, the polarity of that event (0: none yet),
    and the pixel's ON and OFF steps.
    """
    level, side, on, off = band
    if side > 0:
        ahead, width = 0.5 * on, on
    elif side < 0:
        ahead, width = -0.5 * off, off
    else:
        ahead, width = 0.5 * (on - off), on + off
    error = level + ahead - expected
    variance = LEVEL_VARIANCE + width**2 / 12.0
    weight = 1.0 / (variance * (1.0 + (error / RESIDUAL_LEVEL) ** 2))
    if level - off <= expected <= level + on:
        weight *= IN_BAND_WEIGHT
    return error, weight


@njit(cache=True)
def sums_kernel(
    state: tuple[NDArray[np.float32], NDArray[np.int8]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    m: int,
    place: NDArray[np.float64],
    scene: Scene,
    sums: NDArray[np.float64],
) -> None:
    """Sum the normal equations of a disc's centre: xx, xy, yy, x, y, edge in all, edge agreeing.

    ``state`` is the level at which each pixel last fired and the polarity of that event; ``scene``
    is places ``(m, 2)``, nearest others ``(m, k)``, shapes ``(m, 5)`` and ``fit_tables``.
    """
    level, side = state
    height, width = level.shape
    table = scene[3][m]
    radius, edge = scene[2][m, 0], scene[2][m, 1]
    outer, inner = OUTSIDE_EDGES * edge + MARGIN_PX, -INSIDE_EDGES * edge - MARGIN_PX
    sums[:] = 0.0
    top, bottom = bounds_kernel(place[1], radius + outer, height)
    left, right = bounds_kernel(place[0], radius + outer, width)
    crowded = crowded_kernel(m, place, radius + outer, scene)
    for y in range(top, bottom):
        for x in range(left, right):
            dx, dy = x - place[0], y - place[1]
            rho = np.sqrt(dx * dx + dy * dy)
            q = rho - radius
            off_rim = q > outer or q < inner or rho < 0.5
            if off_rim or (crowded and nearer_kernel(x, y, q, m, scene)):
                continue
            expected, fall = read_kernel(q / edge, table)
            band = (level[y, x], side[y, x], steps[0][y, x], steps[1][y, x])
            error, weight = residual_kernel(band, expected)
            slope = fall / edge
            gx, gy = slope / rho * dx, slope / rho * dy
            sums[0] += weight * gx * gx
            sums[1] += weight * gx * gy
            sums[2] += weight * gy * gy
            sums[3] += weight * gx * error
            sums[4] += weight * gy * error
            sums[5] += slope
            sums[6] += slope if abs(error) < AGREEING_LEVEL else 0.0


@njit(cache=True)
def fit_kernel(
    state: tuple[NDArray[np.float32], NDArray[np.int8]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    m: int,
    place: NDArray[np.float64],
    scene: Scene,
    sums: NDArray[np.float64],
) -> float:
    """Move ``place`` to where the disc fits best; return the share of its edge that agrees."""
    for _ in range(ITERATIONS):
        sums_kernel(state, steps, m, place, scene, sums)
        det = sums[0] * sums[2] - sums[1] * sums[1]
        if det <= 1e-9:
            break
        sx = (sums[2] * sums[3] - sums[1] * sums[4]) / det
        sy = (sums[0] * sums[4] - sums[1] * sums[3]) / det
        length = np.sqrt(sx * sx + sy * sy)
        shrink = LARGEST_STEP_PX / length if length > LARGEST_STEP_PX else 1.0
        place[0] += shrink * sx
        place[1] += shrink * sy
        if length < SMALL_STEP_PX:
            break
    return sums[6] / sums[5] if sums[5] > 0.0 else 0.0
