"""Fit of a disc's centre to the graded map, by a few robust Gauss-Newton steps per marker.

The residual e = Y(x) - S(|x - c| - R(phi)) of the pixels around the edge has the Cauchy weight
1 / (1 + (e / soft)^2). The outline R(phi) = r + b cos 2 phi + c sin 2 phi follows the disc slowly:
an indentation magnifies it, strain makes it an ellipse. Both are even in phi and do not bias the
centre; a map that leaks towards a wrong outline would.

Sums are taken over integers. The result of a floating-point sum depends on its order, which a
compiler adapts to the processor's registers; integers give the same tracks on every machine.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import LANES, PHASES, RING_PX, FitWindow
from spikingtac.state_map.graded import PAD_PX, Array

# Pixels of an annulus around a disc's edge: the phase (subpixel cell) of its centre, its first
# pixel in the window, the number of its pixels, and this number rounded up to a multiple of LANES,
# so that loops end with a whole vector. The surplus pixels have weight 0.
Ring = tuple[Any, Any, Any, Any]

# Compiler flags that do not change results: no fused operations, no approximations, no reordered
# sums. So a recording gives the same tracks everywhere.
SAME_BITS = {"nnan", "ninf", "nsz"}

# Largest distance of a marker from the centre of its subpixel cell, half a diagonal, px.
ROUNDING_PX = 0.5 * 2.0**0.5 / PHASES

MOST_GROWTH = 0.3  # Largest change of an outline, as a share of the radius.

# Residual at which a pixel has half weight. A smaller one trusts a lagging disc more than the
# pixels that show its lag, and loses it where events are lost (measured: 0.3 loses markers that 0.8
# tracks, and is less accurate).
SOFT_LEVEL = 0.8

# Largest Gauss-Newton step: over a longer one the edge model is not linear.
LARGEST_STEP_PX = 2.0

# A fit whose last step was shorter has converged. Over a shorter motion of the centre the edge is
# not sampled again: residuals are extrapolated along its slope, and only the weights are new. (0.08
# to 0.14 are alike; fits at 0.04 take longer and err the same.)
LINEAR_STEP_PX = 0.12


def fit_scratch(reach_px: float) -> NDArray[np.float32]:
    """Return ``(3, n)`` scratch for a disc's pixels: map level, model level, model slope."""
    return np.zeros((3, LANES * math.ceil(np.pi * reach_px**2 / LANES)), np.float32)


@kernel(forceinline=True)
def _coefficients_kernel(c: Array, m: Any, k: Any) -> tuple[Any, ...]:  # pragma: no cover
    """Return the coefficients of polynomial k of marker m as a tuple, which stays in registers."""
    first = c[m, k, 0], c[m, k, 1], c[m, k, 2], c[m, k, 3]
    return first + (c[m, k, 4], c[m, k, 5], c[m, k, 6], c[m, k, 7])  # noqa: RUF005 - compiled


@kernel(forceinline=True, fastmath=SAME_BITS)
def _polynomial_kernel(c: tuple[Any, ...], z: Any) -> Any:  # pragma: no cover
    """Evaluate a polynomial of degree 7 by Estrin's scheme, which has more parallelism."""
    z2 = z * z
    low = (c[0] + c[1] * z) + z2 * (c[2] + c[3] * z)
    return low + z2 * z2 * ((c[4] + c[5] * z) + z2 * (c[6] + c[7] * z))


@kernel(forceinline=True, fastmath=SAME_BITS)
def _edge_kernel(
    polar: Array, ring: Ring, disc: tuple[Any, ...], coefficients: Array, edge: Array, m: Any
) -> None:  # pragma: no cover - compiled
    """Write the model's level and slope at each pixel of a ring.

    ``disc`` holds the offset (x, y) of the disc's centre from the centre of its subpixel cell, the
    radius at the middle of the edge, b and c of the outline, and 2 over the width of the edge.
    """
    phase, first, inside, count = ring
    x, y, r, b, c, per_half = disc
    zero, one = np.float32(0.0), np.float32(1.0)
    levels = _coefficients_kernel(coefficients, m, np.uint64(0))
    slopes = _coefficients_kernel(coefficients, m, np.uint64(1))
    for j in range(count):
        to_x, to_y = polar[phase, 1, first + j], polar[phase, 2, first + j]
        bulge = b * polar[phase, 3, first + j] + c * polar[phase, 4, first + j]
        z = (polar[phase, 0, first + j] - (to_x * x + to_y * y) - r - bulge) * per_half
        steep = (abs(z) < one) & (np.int32(j) < inside)
        z = one if z > one else z
        z = -one if z < -one else z
        edge[1, j] = _polynomial_kernel(levels, z)
        edge[2, j] = _polynomial_kernel(slopes, z) if steep else zero


@kernel(forceinline=True, fastmath=SAME_BITS)
def normal_equations_kernel(
    polar: Array, ring: Ring, edge: Array, moved: tuple[Any, Any], unit: np.float32
) -> tuple[Any, ...]:  # pragma: no cover - compiled
    """Sum the robust normal equations of a disc's centre and outline, in one loop of vectors.

    ``moved`` is the motion of the centre since the edge was sampled, px. Returns the centre's
    curvature (xx, xy, yy) and gradient (x, y), the gradient of the outline (r, b, c), and the share
    of the edge that agrees. The curvature of r is xx + yy.
    """
    phase, first, _, count = ring
    one, per_soft2 = np.float32(1.0), np.float32(1.0 / SOFT_LEVEL**2)
    rr = rb = rc = gx = gy = gr = gb = gc = weight = total = np.int32(0)
    for j in range(count):
        to_x, to_y = polar[phase, 1, first + j], polar[phase, 2, first + j]
        cos2, sin2 = polar[phase, 3, first + j], polar[phase, 4, first + j]
        s = edge[2, j]
        e = edge[0, j] - edge[1, j] - s * (to_x * moved[0] + to_y * moved[1])
        us = unit * s
        ws = us / (one + e * e * per_soft2)
        wse, wss = ws * e, ws * s
        rr = np.int32(rr + np.int32(wss))
        rb = np.int32(rb + np.int32(wss * cos2))
        rc = np.int32(rc + np.int32(wss * sin2))
        gx = np.int32(gx + np.int32(wse * to_x))
        gy = np.int32(gy + np.int32(wse * to_y))
        gr = np.int32(gr + np.int32(wse))
        gb = np.int32(gb + np.int32(wse * cos2))
        gc = np.int32(gc + np.int32(wse * sin2))
        weight = np.int32(weight + np.int32(ws))
        total = np.int32(total + np.int32(us))
    part = 1.0 / float(unit)
    # x^2 = (1 + cos 2 phi) / 2, x y = sin 2 phi / 2, and y^2 = (1 - cos 2 phi) / 2.
    curvature = 0.5 * part * (rr + rb), 0.5 * part * rc, 0.5 * part * (rr - rb)
    outline = gr * part, gb * part, gc * part
    return curvature, (gx * part, gy * part), outline, weight / (total + 1.0)


@kernel(forceinline=True)
def step_kernel(
    curvature: tuple[Any, Any, Any], gradient: tuple[Any, Any]
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Solve the 2x2 system, limited to LARGEST_STEP_PX; no step where it is singular.

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
    """Return the ring of pixels between two distances, px, from a subpixel cell's centre.

    It has ``most`` pixels at most: the farthest pixels of a larger outline are left out.
    """
    last = window.within.shape[1] - 1
    near = max(ends_px[0] - ROUNDING_PX, 0.0) / RING_PX
    far = max(ends_px[1] + ROUNDING_PX, 0.0) / RING_PX
    first = window.within[phase, min(int(near), last)]
    inside = min(window.within[phase, min(int(far) + 1, last)] - first, most)
    # Unsigned indices cannot count from the end, which would prevent vectorisation.
    count = (np.uint64(inside) + np.uint64(LANES - 1)) & ~np.uint64(LANES - 1)
    return phase, np.uint64(first), np.int32(inside), count


@kernel(forceinline=True)
def update_outline_kernel(
    outline_px: Array, m: Any, gradient: tuple[Any, Any, Any], step: float, rest_px: float
) -> None:  # pragma: no cover - compiled
    """Update an outline (r, b, c) along its gradient, within MOST_GROWTH of the radius at rest."""
    most = MOST_GROWTH * rest_px
    r, b, c = outline_px[m, 0], outline_px[m, 1], outline_px[m, 2]
    outline_px[m, 0] = min(max(r + step * gradient[0], rest_px - most), rest_px + most)
    outline_px[m, 1] = min(max(b + 2.0 * step * gradient[1], -most), most)
    outline_px[m, 2] = min(max(c + 2.0 * step * gradient[2], -most), most)


@kernel(forceinline=True)
def edge_bounds_kernel(
    window: FitWindow, m: Any, outline_px: Array
) -> tuple[float, float]:  # pragma: no cover
    """Return the distances from marker m's centre at which its edge begins and ends, px."""
    r, bulge = outline_px[m, 0], abs(outline_px[m, 1]) + abs(outline_px[m, 2])
    return r - bulge + window.edge[m, 0], r + bulge + window.edge[m, 1]


@kernel(forceinline=True)
def sample_ring_kernel(
    levels: tuple[Array, int, int], window: FitWindow, m: Any, position_px: tuple[float, float],
    ends_px: tuple[float, float], outline_px: Array, edge: Array,
) -> tuple[Ring, tuple[int, int]]:  # pragma: no cover - compiled # fmt: skip
    """Sample the map in a ring around a position, and the model of marker m's edge there.

    ``ends_px`` is the ring's inner and outer radius. Returns the ring, and row and column of its
    central pixel.
    """
    (flat, width, height), (x, y) = levels, position_px
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
    _edge_kernel(window.polar, ring, disc, window.coefficients, edge, m)
    return ring, (row, column)


@kernel(forceinline=True)
def fit_disc_kernel(
    levels: tuple[Array, int, int], edge: Array, window: FitWindow, marker: int,
    center_px: tuple[float, float], outline_px: Array, settings: tuple[int, float, float],
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled # fmt: skip
    """Fit a marker's centre, and update its outline; return x, y, agreement and last step.

    Args:
        levels: The flat map with its margin of PAD_PX; the sensor's width and height, px.
        edge: ``(3, n)`` scratch: the map's level, the model's level and its slope.
        window: From :func:`~spikingtac.markers.graded.appearance.fit_window`.
        marker: Number of the marker.
        center_px: Start of the fit, px.
        outline_px: ``(m, 3)`` r, b and c of the discs, px; changed.
        settings: Most Gauss-Newton steps; gain of the outline's step; radius at rest, px.
    """
    m, (x, y), length, agreement = np.uint64(marker), center_px, 0.0, 0.0
    ends_px = edge_bounds_kernel(window, m, outline_px)
    ring = np.uint64(0), np.uint64(0), np.int32(0), np.uint64(0)
    read_x = read_y = np.inf
    curvature = outline_gradient = 0.0, 0.0, 0.0
    for _ in range(settings[0]):
        dx, dy = x - read_x, y - read_y
        if not dx * dx + dy * dy < LINEAR_STEP_PX * LINEAR_STEP_PX:
            read_x, read_y, dx, dy = x, y, 0.0, 0.0
            ring, _ = sample_ring_kernel(levels, window, m, (x, y), ends_px, outline_px, edge)
        moved = np.float32(dx), np.float32(dy)
        curvature, gradient, outline_gradient, agreement = normal_equations_kernel(
            window.polar, ring, edge, moved, window.edge[m, 2]
        )
        step_x, step_y, length = step_kernel(curvature, gradient)
        x, y = x + step_x, y + step_y
        if length < LINEAR_STEP_PX:
            break
    step = settings[1] / (curvature[0] + curvature[2] + 1e-3)
    update_outline_kernel(outline_px, m, outline_gradient, step, settings[2])
    return x, y, agreement, length
