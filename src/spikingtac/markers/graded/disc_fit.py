"""Fit a disc's centre to the graded map, by a few robust Gauss-Newton steps per marker.

Residual e = Y(x) - S(|x - c| - R(phi)) over the pixels around the edge, weight
1 / (1 + (e / soft)^2) (Cauchy). The outline R(phi) = r + b cos 2 phi + c sin 2 phi follows the disc
slowly: an indentation magnifies it, strain makes it an ellipse. Both are even in phi and leave the
centre alone, but a map that is held to the wrong outline would not.

Sums are those of whole numbers. A sum of floating-point numbers depends on its order, which a
compiler suits to the processor's registers; whole numbers give the same tracks on every machine.
"""

from typing import Any

import numpy as np
from numba import njit

from spikingtac.markers.graded.appearance import PHASES, RING_PX, FitWindow
from spikingtac.state_map.graded import PAD_PX, Array

# Freedom of the compiler that leaves results alone: no two operations become one, none is
# replaced by an approximation, and no sum is regrouped. So a recording gives the same tracks
# everywhere.
SAME_BITS = {"nnan", "ninf", "nsz"}

# A window's centre lies up to half a diagonal of its part of a pixel from the marker, px.
ROUNDING_PX = 0.5 * 2.0**0.5 / PHASES

MOST_GROWTH = 0.3  # Largest change of an outline, as a share of the radius.

# Residual at which a pixel counts half. A sharper cut trusts a lagging disc more than the pixels
# that show its lag, and loses it where events are lost (measured: 0.3 loses markers that 0.8
# keeps, and is less accurate).
SOFT_LEVEL = 0.8

# A Gauss-Newton step is cut to this length: beyond it the edge model is not linear.
LARGEST_STEP_PX = 2.0

# A fit whose last step was shorter has converged (mean errors at 0.02 to 0.06: within 0.002).
SMALL_STEP_PX = 0.04

# While the centre went no farther, and its outline changed by less, the edge is not read anew: the
# residuals move along its slope, and only their weights are new. (Measured within a fit: tracks
# move by 0.002 to 0.005 px on average, their mean errors rise by at most 0.001; at 0.15 losses of
# events begin to cost accuracy.)
LINEAR_STEP_PX, LINEAR_GROWTH_PX = 0.08, 0.05


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def _polynomial_kernel(c: Array, z: Any) -> Any:  # pragma: no cover
    """Evaluate a polynomial of degree 7 by Estrin's scheme: Horner's waits for each product."""
    z2 = z * z
    low = (c[0] + c[1] * z) + z2 * (c[2] + c[3] * z)
    return low + z2 * z2 * ((c[4] + c[5] * z) + z2 * (c[6] + c[7] * z))


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def _edge_kernel(
    place_px: Array, ring: tuple[Any, Any], disc: tuple[Any, ...], coefficients: Array, edge: Array
) -> None:  # pragma: no cover - compiled
    """Write each pixel's direction (x, y) from the centre, the disc's level, and its slope there.

    ``disc`` is x and y relative to the window, the radius in the middle of the edge's stretch, b
    and c, and 2 over the stretch's length; the rows of ``edge`` are the map's level and these
    results. Two loops, since one with four outputs is not vectorised.
    """
    first, count = ring
    x, y, r, b, c, per_half = disc
    ux, uy, asked, slope = edge[1], edge[2], edge[3], edge[4]
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
        asked[j] = _polynomial_kernel(curve, z)
        slope[j] = _polynomial_kernel(steep, z)


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def center_equations_kernel(
    edge: Array, count: Any, moved: tuple[Any, Any, Any], unit: np.float32
) -> tuple[Any, ...]:  # pragma: no cover - compiled
    """Sum the robust normal equations of a disc's centre; one straight loop, so that it vectorises.

    ``moved`` is how far the centre went and the radius grew since ``edge`` was read, px. Returns
    the curvature (xx, xy, yy) and the gradient (x, y).
    """
    level, ux, uy, asked, slope = edge[0], edge[1], edge[2], edge[3], edge[4]
    one, per_soft2 = np.float32(1.0), np.float32(1.0 / SOFT_LEVEL**2)
    xx = xy = yy = gx = gy = np.int32(0)
    for j in range(count):
        to_x, to_y, s = ux[j], uy[j], slope[j]
        e = level[j] - asked[j] - s * (to_x * moved[0] + to_y * moved[1] + moved[2])
        ws = unit * s / (one + e * e * per_soft2)
        wse = ws * e
        wsx = ws * s * to_x
        wsy = ws * s * to_y
        xx = np.int32(xx + np.int32(wsx * to_x))
        xy = np.int32(xy + np.int32(wsx * to_y))
        yy = np.int32(yy + np.int32(wsy * to_y))
        gx = np.int32(gx + np.int32(wse * to_x))
        gy = np.int32(gy + np.int32(wse * to_y))
    part = 1.0 / float(unit)
    return (xx * part, xy * part, yy * part), (gx * part, gy * part)


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def outline_equations_kernel(
    edge: Array, count: Any, moved: tuple[Any, Any, Any], unit: np.float32
) -> tuple[Any, ...]:  # pragma: no cover - compiled
    """Sum the robust normal equations of a disc's outline as :func:`center_equations_kernel` does.

    Returns the gradients of r, b and c, the curvature of r, and the share of the edge that agrees.
    """
    level, ux, uy, asked, slope = edge[0], edge[1], edge[2], edge[3], edge[4]
    one, per_soft2 = np.float32(1.0), np.float32(1.0 / SOFT_LEVEL**2)
    gr = gb = gc = rr = weight = total = np.int32(0)
    for j in range(count):
        to_x, to_y, s = ux[j], uy[j], slope[j]
        e = level[j] - asked[j] - s * (to_x * moved[0] + to_y * moved[1] + moved[2])
        us = unit * s
        ws = us / (one + e * e * per_soft2)
        wse = ws * e
        gr = np.int32(gr + np.int32(wse))
        gb = np.int32(gb + np.int32(wse * (to_x * to_x - to_y * to_y)))
        gc = np.int32(gc + np.int32(wse * (np.float32(2.0) * to_x * to_y)))
        rr = np.int32(rr + np.int32(ws * s))
        weight = np.int32(weight + np.int32(ws))
        total = np.int32(total + np.int32(us))
    part = 1.0 / float(unit)
    return (gr * part, gb * part, gc * part), rr * part, weight / (total + 1.0)


@njit(cache=True, nogil=True, forceinline=True)
def _step_kernel(
    curvature: tuple[Any, Any, Any], gradient: tuple[Any, Any]
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Solve the 2x2 system, cut to LARGEST_STEP_PX; no step where the edge says nothing."""
    (xx, xy, yy), (gx, gy) = curvature, gradient
    determinant = xx * yy - xy * xy
    if not determinant > 1e-6:
        return 0.0, 0.0
    step_x, step_y = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
    length = np.hypot(step_x, step_y)
    if length > LARGEST_STEP_PX:
        return step_x * LARGEST_STEP_PX / length, step_y * LARGEST_STEP_PX / length
    return step_x, step_y


@njit(cache=True, nogil=True, forceinline=True)
def _ring_kernel(
    window: FitWindow, m: int, read: Array, most: int
) -> tuple[int, Any, Any]:  # pragma: no cover - compiled
    """Return the phase of ``read``, the first pixel of an edge there, and how many follow it.

    There are ``most`` at most: of an outline that grew larger the farthest are not read.
    """
    phase = (int(read[3]) % PHASES) * PHASES + int(read[2]) % PHASES
    within, bulge = window.within[phase], abs(read[5]) + abs(read[6])
    near = max(read[4] - bulge + window.edge[m, 0] - ROUNDING_PX, 0.0) / RING_PX
    far = max(read[4] + bulge + window.edge[m, 1] + ROUNDING_PX, 0.0) / RING_PX
    last = within.size - 1
    first, after = within[min(int(near), last)], within[min(int(far) + 1, last)]
    # Unsigned, so that no index can be meant from the end: that would not be vectorised.
    return phase, np.uint64(first), np.uint64(min(after - first, most))


@njit(cache=True, nogil=True, forceinline=True)
def _follow_kernel(
    outline_px: Array, gradient: tuple[Any, Any, Any], step: float, rest_px: float
) -> None:  # pragma: no cover - compiled
    """Move an outline (r, b, c) along its gradient, within MOST_GROWTH of the radius at rest."""
    most = MOST_GROWTH * rest_px
    outline_px[0] = min(max(outline_px[0] + step * gradient[0], rest_px - most), rest_px + most)
    outline_px[1] = min(max(outline_px[1] + 2.0 * step * gradient[1], -most), most)
    outline_px[2] = min(max(outline_px[2] + 2.0 * step * gradient[2], -most), most)


@njit(cache=True, nogil=True, forceinline=True)
def _look_kernel(
    levels: tuple[Array, int, int], window: FitWindow, ring: tuple[int, Any, Any], read: Array,
    level: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Copy the map's levels around the place of ``read``."""
    (flat, width, _), (phase, first, count) = levels, ring
    column, row, offset = int(read[2]) // PHASES, int(read[3]) // PHASES, window.offset[phase]
    middle = (row + PAD_PX) * (width + 2 * PAD_PX) + column + PAD_PX
    for j in range(count):
        level[j] = flat[np.uint64(middle + offset[first + j])]


@njit(cache=True, nogil=True, forceinline=True)
def _read_kernel(
    window: FitWindow, m: int, ring: tuple[int, Any, Any], read: Array, edge: Array
) -> None:  # pragma: no cover - compiled
    """Read marker m's edge at the place and with the outline of ``read``."""
    inner_px, outer_px = window.edge[m, 0], window.edge[m, 1]
    x = np.float32(read[0] - int(read[2]) // PHASES)
    y = np.float32(read[1] - int(read[3]) // PHASES)
    r = np.float32(read[4] + 0.5 * (inner_px + outer_px))
    outline = r, np.float32(read[5]), np.float32(read[6])
    disc = x, y, *outline, np.float32(2.0) / (outer_px - inner_px)
    _edge_kernel(window.place_px[ring[0]], ring[1:], disc, window.coefficients[m], edge)


@njit(cache=True, nogil=True)
def fit_disc_kernel(
    levels: tuple[Array, int, int], edges: tuple[Array, Array], window: FitWindow, m: int,
    center_px: tuple[float, float], outline_px: Array, settings: tuple[int, float, float],
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled # fmt: skip
    """Fit marker m's centre, and let its outline follow; return x, y, agreement and last step.

    Args:
        levels: The flat map with its margin of PAD_PX; the sensor's width and height, px.
        edges: ``(m, 5, n)`` level, direction (x, y), the disc's level and slope of every pixel of
            the edges as they were read; ``(m, 7)`` where that was: place, px; its column and row
            in parts of a pixel; outline, px. Both change.
        window: From :func:`~spikingtac.markers.graded.appearance.fit_window`.
        m: Which marker.
        center_px: Where the fit begins, px.
        outline_px: ``(3,)`` r, b and c of the disc, px; changed.
        settings: Gauss-Newton steps at most; share of the outline's own step that it makes, 0 for
            none and no agreement; radius at rest, px.
    """
    edge, read = edges[0][m], edges[1][m]
    right, bottom = PHASES * levels[1] - 1, PHASES * levels[2] - 1
    grown, unit = outline_px[0] - read[4], window.edge[m, 2]
    bent = abs(grown) + abs(outline_px[1] - read[5]) + abs(outline_px[2] - read[6])
    (x, y), seen, length = center_px, False, 0.0
    count, moved = np.uint64(0), (np.float32(0.0), np.float32(0.0), np.float32(0.0))
    for _ in range(settings[0]):
        dx, dy = x - read[0], y - read[1]
        near = dx * dx + dy * dy < LINEAR_STEP_PX * LINEAR_STEP_PX and bent < LINEAR_GROWTH_PX
        if not near:
            column = min(max(int(np.floor(PHASES * (x + 0.5))), 0), right)
            row = min(max(int(np.floor(PHASES * (y + 0.5))), 0), bottom)
            seen = seen and bent < LINEAR_GROWTH_PX and column == read[2] and row == read[3]
            read[0], read[1], read[2], read[3] = x, y, column, row
            read[4:] = outline_px
            dx = dy = grown = bent = 0.0
        ring = _ring_kernel(window, m, read, edge.shape[1])
        count = ring[2]
        if not seen:
            _look_kernel(levels, window, ring, read, edge[0])
            seen = True
        if not near:
            _read_kernel(window, m, ring, read, edge)
        moved = np.float32(dx), np.float32(dy), np.float32(grown)
        step_x, step_y = _step_kernel(*center_equations_kernel(edge, count, moved, unit))
        x, y = x + step_x, y + step_y
        length = np.hypot(step_x, step_y)
        if length < SMALL_STEP_PX:
            break
    if settings[1] == 0.0:
        return x, y, np.nan, length
    gradient, rr, agreement = outline_equations_kernel(edge, count, moved, unit)
    _follow_kernel(outline_px, gradient, settings[1] / (rr + 1e-3), settings[2])
    return x, y, agreement, length
