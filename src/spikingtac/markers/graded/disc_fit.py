"""Fit a disc's centre to the graded map, by a few robust Gauss-Newton steps per marker.

Residual e = Y(x) - S(|x - c| - R(phi)) over the pixels around the edge, weight
1 / (1 + (e / soft)^2) (Cauchy). The outline R(phi) = r + b cos 2 phi + c sin 2 phi follows the disc
slowly: an indentation magnifies it, strain makes it an ellipse. Both are even in phi and leave the
centre alone, but a map that is held to the wrong outline would not.

Sums are those of whole numbers. A sum of floating-point numbers depends on its order, which a
compiler suits to the processor's registers; whole numbers give the same tracks on every machine.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import LANES, PHASES, RING_PX, FitWindow
from spikingtac.state_map.graded import PAD_PX, Array

# Part of a pixel in which an edge was read, its first pixel in the window, how many follow, and how
# many are read: a multiple of LANES, so that loops end with a whole vector. The others weigh 0.
Ring = tuple[Any, Any, Any, Any]

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

# A fit whose last step was shorter has converged. While the centre went no farther, the edge is not
# read anew: the residuals move along its slope, and only their weights are new. (0.08 to 0.14 are
# alike; fits at 0.04 take longer and err the same.)
LINEAR_STEP_PX = 0.12


def fit_scratch(reach_px: float) -> NDArray[np.float32]:
    """Return ``(3, n)`` scratch for the pixels of a disc: level, the disc's level, its slope."""
    return np.zeros((3, LANES * math.ceil(np.pi * reach_px**2 / LANES)), np.float32)


@kernel(forceinline=True)
def _coefficients_kernel(c: Array, m: Any, k: Any) -> tuple[Any, ...]:  # pragma: no cover
    """Return the coefficients of polynomial k of marker m; in an array a loop reads them anew."""
    first = c[m, k, 0], c[m, k, 1], c[m, k, 2], c[m, k, 3]
    return first + (c[m, k, 4], c[m, k, 5], c[m, k, 6], c[m, k, 7])  # noqa: RUF005 - compiled


@kernel(forceinline=True, fastmath=SAME_BITS)
def _polynomial_kernel(c: tuple[Any, ...], z: Any) -> Any:  # pragma: no cover
    """Evaluate a polynomial of degree 7 by Estrin's scheme: Horner's waits."""
    z2 = z * z
    low = (c[0] + c[1] * z) + z2 * (c[2] + c[3] * z)
    return low + z2 * z2 * ((c[4] + c[5] * z) + z2 * (c[6] + c[7] * z))


@kernel(forceinline=True, fastmath=SAME_BITS)
def _edge_kernel(
    around: Array, ring: Ring, disc: tuple[Any, ...], coefficients: Array, edge: Array, m: Any
) -> None:  # pragma: no cover - compiled
    """Write the disc's level at each pixel of a ring, and its slope there.

    ``disc`` is how far its centre is from the part of a pixel around which the ring lies, the
    radius in the middle of the edge's stretch, b and c, and 2 over the stretch's length.
    """
    phase, first, inside, count = ring
    x, y, r, b, c, per_half = disc
    zero, one = np.float32(0.0), np.float32(1.0)
    levels = _coefficients_kernel(coefficients, m, np.uint64(0))
    slopes = _coefficients_kernel(coefficients, m, np.uint64(1))
    for j in range(count):
        to_x, to_y = around[phase, 1, first + j], around[phase, 2, first + j]
        bulge = b * (to_x * to_x - to_y * to_y) + c * np.float32(2.0) * to_x * to_y
        z = (around[phase, 0, first + j] - (to_x * x + to_y * y) - r - bulge) * per_half
        steep = (abs(z) < one) & (np.int32(j) < inside)
        z = one if z > one else z
        z = -one if z < -one else z
        edge[1, j] = _polynomial_kernel(levels, z)
        edge[2, j] = _polynomial_kernel(slopes, z) if steep else zero


@kernel(forceinline=True, fastmath=SAME_BITS)
def center_equations_kernel(
    around: Array, ring: Ring, edge: Array, moved: tuple[Any, Any], unit: np.float32
) -> tuple[Any, ...]:  # pragma: no cover - compiled
    """Sum the robust normal equations of a disc's centre; one straight loop, so that it vectorises.

    ``moved`` is how far the centre went since the edge was read, px. Returns
    the curvature (xx, xy, yy) and the gradient (x, y).
    """
    phase, first, _, count = ring
    one, per_soft2 = np.float32(1.0), np.float32(1.0 / SOFT_LEVEL**2)
    xx = xy = yy = gx = gy = np.int32(0)
    for j in range(count):
        to_x, to_y = around[phase, 1, first + j], around[phase, 2, first + j]
        s = edge[2, j]
        e = edge[0, j] - edge[1, j] - s * (to_x * moved[0] + to_y * moved[1])
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


@kernel(forceinline=True, fastmath=SAME_BITS)
def outline_equations_kernel(
    around: Array, ring: Ring, edge: Array, moved: tuple[Any, Any], unit: np.float32
) -> tuple[Any, ...]:  # pragma: no cover - compiled
    """Sum the robust normal equations of a disc's outline as :func:`center_equations_kernel` does.

    Returns the gradients of r, b and c, the curvature of r, and the share of the edge that agrees.
    """
    phase, first, _, count = ring
    one, per_soft2 = np.float32(1.0), np.float32(1.0 / SOFT_LEVEL**2)
    gr = gb = gc = rr = weight = total = np.int32(0)
    for j in range(count):
        to_x, to_y = around[phase, 1, first + j], around[phase, 2, first + j]
        s = edge[2, j]
        e = edge[0, j] - edge[1, j] - s * (to_x * moved[0] + to_y * moved[1])
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


@kernel(forceinline=True)
def step_kernel(
    curvature: tuple[Any, Any, Any], gradient: tuple[Any, Any]
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Solve the 2x2 system, cut to LARGEST_STEP_PX; no step where the edge says nothing.

    Returns the step and its length, px.
    """
    (xx, xy, yy), (gx, gy) = curvature, gradient
    determinant = xx * yy - xy * xy
    if not determinant > 1e-6:
        return 0.0, 0.0, 0.0
    step_x, step_y = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
    length = np.sqrt(step_x * step_x + step_y * step_y)
    if length > LARGEST_STEP_PX:
        cut = LARGEST_STEP_PX / length
        return step_x * cut, step_y * cut, LARGEST_STEP_PX
    return step_x, step_y, length


@kernel(forceinline=True)
def ring_kernel(
    window: FitWindow, phase: Any, ends_px: tuple[float, float], most: int
) -> Ring:  # pragma: no cover - compiled
    """Return a ring around a part of a pixel: the first pixel, and how many follow.

    There are ``most`` at most: of an outline that grew larger the farthest are not read.
    """
    last = window.within.shape[1] - 1
    near = max(ends_px[0] - ROUNDING_PX, 0.0) / RING_PX
    far = max(ends_px[1] + ROUNDING_PX, 0.0) / RING_PX
    first = window.within[phase, min(int(near), last)]
    after = window.within[phase, min(int(far) + 1, last)]
    inside = min(after - first, most)
    # Unsigned, so that no index can be meant from the end: that would not be vectorised.
    count = (np.uint64(inside) + np.uint64(LANES - 1)) & ~np.uint64(LANES - 1)
    return phase, np.uint64(first), np.int32(inside), count


@kernel(forceinline=True)
def follow_kernel(
    outline_px: Array, m: Any, gradient: tuple[Any, Any, Any], step: float, rest_px: float
) -> None:  # pragma: no cover - compiled
    """Move an outline (r, b, c) along its gradient, within MOST_GROWTH of the radius at rest."""
    most = MOST_GROWTH * rest_px
    r, b, c = outline_px[m, 0], outline_px[m, 1], outline_px[m, 2]
    outline_px[m, 0] = min(max(r + step * gradient[0], rest_px - most), rest_px + most)
    outline_px[m, 1] = min(max(b + 2.0 * step * gradient[1], -most), most)
    outline_px[m, 2] = min(max(c + 2.0 * step * gradient[2], -most), most)


@kernel(forceinline=True)
def ends_kernel(
    window: FitWindow, m: Any, outline_px: Array
) -> tuple[float, float]:  # pragma: no cover
    """Return how far from marker m's centre its edge begins and ends, px."""
    r, bulge = outline_px[m, 0], abs(outline_px[m, 1]) + abs(outline_px[m, 2])
    return r - bulge + window.edge[m, 0], r + bulge + window.edge[m, 1]


@kernel(forceinline=True)
def read_kernel(
    levels: tuple[Array, int, int], window: FitWindow, m: Any, place_px: tuple[float, float],
    ends_px: tuple[float, float], outline_px: Array, edge: Array,
) -> tuple[Ring, tuple[int, int]]:  # pragma: no cover - compiled # fmt: skip
    """Read the map's levels in a ring around a place, and marker m's edge as it would be there.

    ``ends_px`` is where the ring begins and ends. Returns it, and row and column of its middle.
    """
    (flat, width, height), (x, y) = levels, place_px
    part_x = min(max(np.floor(PHASES * (x + 0.5)), 0.0), PHASES * width - 1.0)
    part_y = min(max(np.floor(PHASES * (y + 0.5)), 0.0), PHASES * height - 1.0)
    row, column = int(part_y) // PHASES, int(part_x) // PHASES
    phase = (int(part_y) % PHASES) * PHASES + int(part_x) % PHASES
    ring = phase, first, _, count = ring_kernel(window, np.uint64(phase), ends_px, edge.shape[1])
    middle = (row + PAD_PX) * (width + 2 * PAD_PX) + column + PAD_PX
    for j in range(count):
        edge[0, j] = flat[np.uint64(middle + window.offset[phase, 0, first + j])]
    inner_px, outer_px = window.edge[m, 0], window.edge[m, 1]
    off_x = np.float32(x + 0.5 - (part_x + 0.5) / PHASES)
    off_y = np.float32(y + 0.5 - (part_y + 0.5) / PHASES)
    r = np.float32(outline_px[m, 0] + 0.5 * (inner_px + outer_px))
    outline = r, np.float32(outline_px[m, 1]), np.float32(outline_px[m, 2])
    disc = off_x, off_y, *outline, np.float32(2.0) / (outer_px - inner_px)
    _edge_kernel(window.around, ring, disc, window.coefficients, edge, m)
    return ring, (row, column)


@kernel(forceinline=True)
def fit_disc_kernel(
    levels: tuple[Array, int, int], edge: Array, window: FitWindow, marker: int,
    center_px: tuple[float, float], outline_px: Array, settings: tuple[int, float, float],
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled # fmt: skip
    """Fit a marker's centre, and let its outline follow; return x, y, agreement and last step.

    Args:
        levels: The flat map with its margin of PAD_PX; the sensor's width and height, px.
        edge: ``(3, n)`` scratch: the map's level, the disc's, and its slope at the edge's pixels.
        window: From :func:`~spikingtac.markers.graded.appearance.fit_window`.
        marker: Which marker.
        center_px: Where the fit begins, px.
        outline_px: ``(m, 3)`` r, b and c of the discs, px; changed.
        settings: Gauss-Newton steps at most; share of the outline's own step that it makes, 0 for
            none and no agreement; radius at rest, px.
    """
    m, (x, y), length = np.uint64(marker), center_px, 0.0
    ends_px = ends_kernel(window, m, outline_px)
    ring = np.uint64(0), np.uint64(0), np.int32(0), np.uint64(0)
    read_x, read_y, moved = np.inf, np.inf, (np.float32(0.0), np.float32(0.0))
    for _ in range(settings[0]):
        dx, dy = x - read_x, y - read_y
        if not dx * dx + dy * dy < LINEAR_STEP_PX * LINEAR_STEP_PX:
            read_x, read_y, dx, dy = x, y, 0.0, 0.0
            ring, _ = read_kernel(levels, window, m, (x, y), ends_px, outline_px, edge)
        moved = np.float32(dx), np.float32(dy)
        step_x, step_y, length = step_kernel(
            *center_equations_kernel(window.around, ring, edge, moved, window.edge[m, 2])
        )
        x, y = x + step_x, y + step_y
        if length < LINEAR_STEP_PX:
            break
    if settings[1] == 0.0:
        return x, y, np.nan, length
    gradient, rr, agreement = outline_equations_kernel(
        window.around, ring, edge, moved, window.edge[m, 2]
    )
    follow_kernel(outline_px, m, gradient, settings[1] / (rr + 1e-3), settings[2])
    return x, y, agreement, length
