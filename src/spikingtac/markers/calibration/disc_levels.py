"""Discs as the calibration's kernels draw and fit them.

See :mod:`spikingtac.markers.profile` for the formula of the level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.profile import DiscProfile

REACH_EDGES = 6.0
"""Tables reach so many edge widths to both sides of the rim; the level is within 0.01 of its ends
there for contrasts up to 12."""

TABLE_STEPS = 256
"""Entries of a table: the level changes by at most 0.02 between two."""

ITERATIONS = 3
"""Gauss-Newton steps at each sample: the markers move by less than a pixel between two."""

LARGEST_STEP_PX = 1.5
"""Bound of one Gauss-Newton step."""

INSIDE_EDGES, OUTSIDE_EDGES, MARGIN_PX = 4.5, 3.5, 1.0
"""The annulus of a fit: so many edge widths, and this margin, inside and outside of the rim."""

RESIDUAL_LEVEL = 0.3
"""Residuals beyond this level count less (Cauchy weights)."""

LEVEL_VARIANCE = 0.003
"""Variance of a level apart from its step's: shape and thresholds are never exact. (0.055 of a
swing, ours: the rms of the levels that the model left over on simulated recordings.)"""

IN_BAND_WEIGHT = 0.6
"""A level inside of its band counts less than one outside of it."""

AGREEING_LEVEL = 0.35
"""A pixel agrees with the disc within this level."""

SMALL_STEP_PX = 0.01
"""A fit ends after a smaller step."""

NEIGHBOURS = 8
"""Nearest markers that a disc is told from."""


@dataclass(frozen=True, slots=True)
class Discs:
    """How each marker looks.

    Attributes:
        radius_px: ``(m,)`` nominal radius, px.
        edge_px: ``(m,)`` logistic scale of the edge, px.
        contrast: ``(m,)`` intensity of the marker over that of its ground, above 1.
    """

    radius_px: NDArray[np.float64]
    edge_px: NDArray[np.float64]
    contrast: NDArray[np.float64]

    def with_shape(self, radius_px: NDArray[np.float64], edge_px: NDArray[np.float64]) -> Discs:
        """Return the same discs with other radii and edges."""
        return replace(self, radius_px=radius_px, edge_px=edge_px)

    @property
    def shape(self) -> NDArray[np.float64]:
        """``(m, 3)`` radius, edge (px) and contrast minus 1, as kernels read them."""
        return np.column_stack([self.radius_px, self.edge_px, self.contrast - 1.0])

    @property
    def tables(self) -> NDArray[np.float32]:
        """``(m, TABLE_STEPS)`` level from -REACH_EDGES to +REACH_EDGES edge widths."""
        z = np.linspace(-REACH_EDGES, REACH_EDGES, TABLE_STEPS)
        return np.array(
            [DiscProfile(float(contrast), 1.0).level(z) for contrast in self.contrast], np.float32
        )


def nearest_markers(center_px: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return ``(m, k)`` indices of each marker's nearest others, nearest first."""
    distance = np.hypot(*(center_px[:, np.newaxis] - center_px[np.newaxis]).transpose(2, 0, 1))
    count = min(NEIGHBOURS, len(center_px) - 1)
    return np.ascontiguousarray(np.argsort(distance, axis=1)[:, 1 : 1 + count])


@njit(cache=True)
def bounds_kernel(center: float, reach: float, size: int) -> tuple[int, int]:
    """Return the first pixel and the one after the last within ``reach``, inside of the image."""
    first = max(0, int(np.floor(center - reach)))
    last = min(size, int(np.ceil(center + reach)) + 1)
    return first, max(first, last)


@njit(cache=True)
def level_kernel(q_px: float, edge_px: float, table: NDArray[np.float32]) -> np.float32:
    """Return the level at a distance outside of the rim from a marker's table."""
    z = (q_px / edge_px + REACH_EDGES) * ((TABLE_STEPS - 1) / (2.0 * REACH_EDGES))
    if z >= TABLE_STEPS - 1:
        return np.float32(0.0)
    if z <= 0.0:
        return np.float32(1.0)
    cell = int(z)
    return table[cell] + np.float32(z - cell) * (table[cell + 1] - table[cell])


@njit(cache=True)
def draw_kernel(
    center: NDArray[np.float64],
    discs: tuple[NDArray[np.float64], NDArray[np.float32]],
    image: tuple[NDArray[np.float32], NDArray[np.int32]],
    touched: NDArray[np.int64],
) -> int:
    """Draw all discs; return how many pixels were touched.

    Args:
        center: ``(m, 2)`` places, px.
        discs: Shape ``(m, 3)`` and tables ``(m, TABLE_STEPS)``.
        image: ``(height, width)`` level and owner; the owner must be -1 everywhere before.
        touched: Room for the indices of the touched pixels.
    """
    shape, tables = discs
    level, owner = image
    height, width = level.shape
    count = 0
    for m in range(len(shape)):
        radius, edge = shape[m, 0], shape[m, 1]
        reach = radius + REACH_EDGES * edge
        top, bottom = bounds_kernel(center[m, 1], reach, height)
        left, right = bounds_kernel(center[m, 0], reach, width)
        for y in range(top, bottom):
            for x in range(left, right):
                rho = np.sqrt((x - center[m, 0]) ** 2 + (y - center[m, 1]) ** 2)
                if rho > reach:
                    continue
                value = level_kernel(rho - radius, edge, tables[m])
                if owner[y, x] < 0:
                    touched[count] = y * width + x
                    count += 1
                elif value <= level[y, x]:
                    continue
                level[y, x] = value
                owner[y, x] = m
    return count


@njit(cache=True)
def crowded_kernel(
    m: int,
    place: NDArray[np.float64],
    reach: float,
    scene: tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]],
) -> bool:
    """Return whether another disc's surroundings overlap those within ``reach`` of a place."""
    center, nearest, _ = scene
    for other in nearest[m]:
        dx, dy = center[other, 0] - place[0], center[other, 1] - place[1]
        if dx * dx + dy * dy < 4.0 * reach * reach:
            return True
    return False


@njit(cache=True)
def nearer_kernel(
    x: float,
    y: float,
    q_px: float,
    m: int,
    scene: tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]],
) -> bool:
    """Return whether a pixel at ``q_px`` from marker ``m``'s rim is nearer to another's rim."""
    center, nearest, shape = scene
    for other in nearest[m]:
        limit = max(q_px + shape[other, 0], 0.0)
        if (x - center[other, 0]) ** 2 + (y - center[other, 1]) ** 2 < limit * limit:
            return True
    return False


@njit(cache=True)
def profile_kernel(z: Any, edge_px: Any, k: Any) -> tuple[float, float]:
    """Return the level at ``z`` edge widths outside of the rim, and its fall there, 1 / px."""
    cover = 1.0 / (1.0 + np.exp(max(z, -30.0)))
    light = 1.0 + k * cover
    swing = np.log1p(k)
    return np.log(light) / swing, k * cover * (1.0 - cover) / (edge_px * light * swing)


@njit(cache=True)
def reading_kernel(side: Any, on: Any, off: Any) -> tuple[float, float]:
    """Return how far the light is probably beyond the last level, and how wide that range is."""
    if side > 0:
        return 0.5 * on, on
    if side < 0:
        return -0.5 * off, off
    return 0.5 * (on - off), on + off


@njit(cache=True)
def sums_kernel(
    state: tuple[NDArray[np.float32], NDArray[np.int8]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    m: int,
    place: NDArray[np.float64],
    scene: tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]],
    sums: NDArray[np.float64],
) -> None:
    """Sum the normal equations of a disc's centre: xx, xy, yy, x, y, edge in all, edge agreeing.

    ``state`` is the level at which each pixel last fired and the polarity of that event; ``scene``
    is places ``(m, 2)``, nearest others ``(m, k)`` and shapes ``(m, 3)``.
    """
    level, side = state
    height, width = level.shape
    radius, edge, k = scene[2][m]
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
            expected, slope = profile_kernel(q / edge, edge, k)
            on, off = steps[0][y, x], steps[1][y, x]
            ahead, width_of_band = reading_kernel(side[y, x], on, off)
            error = level[y, x] + ahead - expected
            variance = LEVEL_VARIANCE + width_of_band**2 / 12.0
            weight = 1.0 / variance / (1.0 + (error / RESIDUAL_LEVEL) ** 2)
            if level[y, x] - off <= expected <= level[y, x] + on:
                weight *= IN_BAND_WEIGHT
            gx, gy = slope * dx / rho, slope * dy / rho
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
    scene: tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]],
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
