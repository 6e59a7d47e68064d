"""Fit a disc's centre to the graded map, by a few robust Gauss-Newton steps per marker.

Residual e = Y(x) - S(|x - c| - R(phi)) over the pixels around the edge, weight
1 / (1 + (e / soft)^2) (Cauchy), pixels and S from :mod:`spikingtac.markers.graded.fit_window`.
Each pass is three straight loops over the pixels: in one loop the sums would not fit into the
registers. The outline
R(phi) = r + b cos 2 phi + c sin 2 phi follows the disc slowly: an indentation magnifies it, strain
makes it an ellipse. Both are even in phi and leave the centre alone, but a map that is held to the
wrong outline would not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.edge_equations import (
    SAME_BITS,
    center_equations_kernel,
    outline_equations_kernel,
)
from spikingtac.markers.graded.fit_window import RING_PX
from spikingtac.state_map.graded import PAD_PX

SOFT_LEVEL = 0.8
"""Residual at which a pixel counts half. A sharper cut trusts a lagging disc more than the pixels
that show its lag, and loses it where events are lost (measured: 0.3 loses markers that 0.8 keeps,
and is less accurate)."""

LARGEST_STEP_PX = 2.0
"""A Gauss-Newton step is cut to this length: beyond it the edge model is not linear."""

SMALL_STEP_PX = 0.04
"""A fit whose last step was shorter has converged (mean errors at 0.02 to 0.06: within 0.002)."""

LINEAR_STEP_PX = 0.08
"""While the centre went no farther, the edge is not read anew: the residuals move along its slope,
and only their weights are new (measured: tracks move by 0.002 to 0.005 px on average, their mean
errors rise by at most 0.001; at 0.15 losses of events begin to cost accuracy)."""

ROUNDING_PX = 0.75
"""The window is centred on a whole pixel, up to half a diagonal from the marker."""


def round_outline(radius_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(m, 3)`` outlines of round discs: the radius, and no second harmonic, px."""
    return np.column_stack([radius_px, np.zeros((len(radius_px), 2))])


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def _polynomial_kernel(c: NDArray[np.float32], z: Any) -> Any:  # pragma: no cover
    """Evaluate a polynomial of degree 11 by Estrin's scheme: Horner's waits for each product."""
    z2 = z * z
    z4 = z2 * z2
    low = (c[0] + c[1] * z) + z2 * (c[2] + c[3] * z)
    low += z4 * ((c[4] + c[5] * z) + z2 * (c[6] + c[7] * z))
    return low + z4 * z4 * ((c[8] + c[9] * z) + z2 * (c[10] + c[11] * z))


@njit(cache=True, nogil=True)
def _ring_kernel(
    within: NDArray[np.int64], state: NDArray[np.float64], inner_px: float, outer_px: float
) -> tuple[Any, Any]:  # pragma: no cover - compiled
    """Return the first pixel of a window that a disc's edge may reach, and how many follow it."""
    bulge = abs(state[3]) + abs(state[4])
    near = max(state[2] - bulge + inner_px - ROUNDING_PX, 0.0) / RING_PX
    far = max(state[2] + bulge + outer_px + ROUNDING_PX, 0.0) / RING_PX
    last = within.size - 1
    first, after = within[min(int(near), last)], within[min(int(far) + 1, last)]
    # Unsigned, so that no index can be meant from the end: that would not be vectorised.
    return np.uint64(first), np.uint64(after - first)


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def _edge_kernel(
    place_px: NDArray[np.float32],
    ring: tuple[Any, Any],
    disc: tuple[Any, ...],
    coefficients: NDArray[np.float32],
    edge: NDArray[np.float32],
) -> None:  # pragma: no cover - compiled
    """Write each pixel's direction (x, y) from the centre, its residual, and the slope there.

    ``disc`` is x and y relative to the window, the radius in the middle of the edge's stretch, b
    and c, and 2 over the stretch's length; the rows of ``edge`` are the level and these results.
    Two loops, since one with four outputs is not vectorised.
    """
    first, count = ring
    x, y, r, b, c, per_half = disc
    level, ux, uy, residual, slope = edge[0], edge[1], edge[2], edge[3], edge[4]
    dx, dy = place_px[0], place_px[1]
    curve, steep = coefficients[0], coefficients[1]
    one = np.float32(1.0)
    for j in range(count):
        across, down = dx[first + j] - x, dy[first + j] - y
        rho2 = across * across + down * down + np.float32(1e-6)
        inverse = one / np.sqrt(rho2)
        to_x, to_y = across * inverse, down * inverse
        bulge = b * (to_x * to_x - to_y * to_y) + c * np.float32(2.0) * to_x * to_y
        z = (rho2 * inverse - r - bulge) * per_half
        z = one if z > one else z
        slope[j] = -one if z < -one else z
        ux[j], uy[j] = to_x, to_y
    for j in range(count):
        z = slope[j]
        residual[j] = level[j] - _polynomial_kernel(curve, z)
        slope[j] = _polynomial_kernel(steep, z)


@njit(cache=True, nogil=True)
def _center_step_kernel(
    curvature: tuple[Any, Any, Any],
    gradient: tuple[Any, Any],
    away: tuple[float, float],
    weight: float,
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Solve the 2x2 system, cut to LARGEST_STEP_PX; no step where the edge says nothing.

    ``away`` leads to where the neighbours expect the marker, ``weight`` is their share.
    """
    pull = weight * 0.5 * (curvature[0] + curvature[2])
    xx, xy, yy = curvature[0] + pull, curvature[1], curvature[2] + pull
    gx, gy = gradient[0] + pull * away[0], gradient[1] + pull * away[1]
    determinant = xx * yy - xy * xy
    if not determinant > 1e-6:
        return 0.0, 0.0
    step_x, step_y = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
    length = np.hypot(step_x, step_y)
    if length > LARGEST_STEP_PX:
        return step_x * LARGEST_STEP_PX / length, step_y * LARGEST_STEP_PX / length
    return step_x, step_y


@njit(cache=True, nogil=True)
def _nearest_pixel_kernel(
    state: NDArray[np.float64], columns: int, rows: int
) -> tuple[int, int]:  # pragma: no cover - compiled
    """Return the column and row of the sensor's pixel that is nearest to a disc's centre."""
    column, row = int(np.rint(state[0])), int(np.rint(state[1]))
    last_column, last_row = columns - 2 * PAD_PX - 1, rows - 2 * PAD_PX - 1
    return min(max(column, 0), last_column), min(max(row, 0), last_row)


@njit(cache=True, nogil=True)
def _read_kernel(
    flat: NDArray[np.float32],
    middle: int,
    offset: NDArray[np.int64],
    ring: tuple[Any, Any],
    level: NDArray[np.float32],
) -> None:  # pragma: no cover - compiled
    """Copy a ring of pixels around the one at ``middle`` out of the flat padded map."""
    first, count = ring
    for j in range(count):
        level[j] = flat[np.uint64(middle) + np.uint64(offset[first + j])]


@njit(cache=True, nogil=True)
def _fit_one_kernel(
    levels: tuple[NDArray[np.float32], int, int],
    window: tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]],
    edge: NDArray[np.float32],
    state: NDArray[np.float64],
    curves: tuple[Any, ...],
    prior: tuple[float, float, float],
) -> tuple[Any, ...]:  # pragma: no cover - compiled
    """Move one marker's centre to the best fit.

    ``levels`` are the flat padded map, its columns and its rows; ``edge`` is scratch; ``state`` is
    (x, y, r, b, c), px, and changed; ``prior`` is the expected x and y and their weight. Returns
    the gradients of r, b and c, the curvature of r, and the agreement.
    """
    flat, columns, rows = levels
    offset, place_px, within = window
    coefficients, inner_px, outer_px, unit, iterations = curves
    ring = _ring_kernel(within, state, inner_px, outer_px)
    per_half = np.float32(2.0 / (outer_px - inner_px))
    r = np.float32(state[2] + 0.5 * (inner_px + outer_px))
    b, c = np.float32(state[3]), np.float32(state[4])
    per_soft2 = np.float32(1.0 / SOFT_LEVEL**2)
    moved = read_to = np.float32(0.0), np.float32(0.0)
    column, row, fresh = -1, -1, False
    for _ in range(iterations):
        if not fresh:
            at = _nearest_pixel_kernel(state, columns, rows)
            if at[0] != column or at[1] != row:
                column, row = at
                middle = (row + PAD_PX) * columns + column + PAD_PX
                _read_kernel(flat, middle, offset, ring, edge[0])
            x, y = np.float32(state[0] - column), np.float32(state[1] - row)
            _edge_kernel(place_px, ring, (x, y, r, b, c, per_half), coefficients, edge)
            moved = np.float32(0.0), np.float32(0.0)
        curvature, gradient = center_equations_kernel(edge, ring[1], moved, per_soft2, unit)
        away = prior[0] - state[0], prior[1] - state[1]
        step_x, step_y = _center_step_kernel(curvature, gradient, away, prior[2])
        state[0] += step_x
        state[1] += step_y
        read_to, moved = moved, (moved[0] + np.float32(step_x), moved[1] + np.float32(step_y))
        if step_x * step_x + step_y * step_y < SMALL_STEP_PX * SMALL_STEP_PX:
            break
        fresh = moved[0] * moved[0] + moved[1] * moved[1] < LINEAR_STEP_PX * LINEAR_STEP_PX
    return outline_equations_kernel(edge, ring[1], read_to, per_soft2, unit)


@njit(cache=True, nogil=True)
def fit_discs_kernel(
    padded: NDArray[np.float32],
    center_px: NDArray[np.float64],
    outline_px: NDArray[np.float64],
    window: tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]],
    curves: tuple[Any, ...],
    prior: tuple[NDArray[np.float64], float],
    follow: tuple[NDArray[np.float64], float, float],
    agreement: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Move every centre to the best fit and every outline a little, in place.

    Args:
        padded: The map with its margin of PAD_PX.
        center_px: ``(m, 2)`` start and result, px.
        outline_px: ``(m, 3)`` r, b and c of each disc, px.
        window: Offsets, places and counts of :class:`FitWindow`.
        curves: Coefficients, inner and outer ends (px) and units of :class:`FitWindow`;
            Gauss-Newton steps at most.
        prior: ``(m, 2)`` where the neighbours expect each marker, px, and its weight as a share of
            the fit's own curvature.
        follow: ``(m,)`` radii at rest, px; largest change of the outline as a share of them; share
            of its Gauss-Newton step that the outline makes.
        agreement: ``(m,)`` result: share of the edge that agrees with the fit, 0 to 1.
    """
    rest_px, most_share, gain = follow
    coefficients, inner_px, outer_px, unit, iterations = curves
    levels = padded.ravel(), padded.shape[1], padded.shape[0]
    edge = np.empty((5, window[0].size), np.float32)
    state = np.empty(5)
    for m in range(center_px.shape[0]):
        state[0], state[1] = center_px[m, 0], center_px[m, 1]
        for k in range(3):  # a slice assignment would compile for seconds, and runs no faster
            state[2 + k] = outline_px[m, k]
        expected = prior[0][m, 0], prior[0][m, 1], prior[1]
        curve = coefficients[m], inner_px[m], outer_px[m], unit[m], iterations
        (gr, gb, gc), rr, agreement[m] = _fit_one_kernel(
            levels, window, edge, state, curve, expected
        )
        center_px[m, 0], center_px[m, 1] = state[0], state[1]
        step, most = gain / (rr + 1e-3), most_share * rest_px[m]
        r, b, c = state[2] + step * gr, state[3] + 2.0 * step * gb, state[4] + 2.0 * step * gc
        outline_px[m, 0] = min(max(r, rest_px[m] - most), rest_px[m] + most)
        outline_px[m, 1] = min(max(b, -most), most)
        outline_px[m, 2] = min(max(c, -most), most)
