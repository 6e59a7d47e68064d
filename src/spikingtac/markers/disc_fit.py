"""Fit a disc's centre to the graded map, by a few robust Gauss-Newton steps per marker.

Residual e = Y(x) - S(|x - c| - R) over the pixels around the edge, weight 1 / (1 + (e / soft)^2)
(Cauchy), S of :mod:`spikingtac.markers.profile` as a polynomial, which the compiler can vectorise
where it cannot vectorise a table or an exponential.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from spikingtac.markers.profile import DiscProfile
from spikingtac.state_map.graded import PAD_PX

POLYNOMIAL_DEGREE = 15
"""S within 0.0005 and dS/dq within 0.004 per px of the formula at contrast 6."""

SOFT_LEVEL = 0.3
"""Residual at which a pixel counts half: two steps of a typical sensor."""

LARGEST_STEP_PX = 2.0
"""A Gauss-Newton step is cut to this length: beyond it the edge model is not linear."""

SMALL_STEP_PX = 0.02
"""A fit whose last step was shorter has converged: the error falls with its square."""

ROUNDING_PX = 0.75
"""The window of pixels is centred on a whole pixel, up to half a diagonal from the marker."""


@dataclass(frozen=True, slots=True)
class FitWindow:
    """The pixels that a fit reads, as offsets from the pixel nearest to the centre.

    Attributes:
        offset: ``int64[n]`` offsets into the flat padded map.
        dx: ``float32[n]`` columns relative to the central pixel, px.
        dy: ``float32[n]`` rows relative to the central pixel, px.
        coefficients: ``(2, POLYNOMIAL_DEGREE + 1)`` float32 polynomials of S and -dS/dq in q/reach.
        reach_px: Distance from the edge at which the profile is flat, px.
    """

    offset: NDArray[np.int64]
    dx: NDArray[np.float32]
    dy: NDArray[np.float32]
    coefficients: NDArray[np.float32]
    reach_px: float


def fit_window(
    profile: DiscProfile,
    radius_px: NDArray[np.float64],
    width_px: int,
    reach_px: float,
) -> FitWindow:
    """Choose the pixels and the polynomials for discs of the given radii.

    Args:
        profile: The disc's profile.
        radius_px: ``(m,)`` radii; one window serves all of them.
        width_px: Width of the sensor, px.
        reach_px: Half the width of the annulus, px.
    """
    row_px = width_px + 2 * PAD_PX
    outer = float(radius_px.max()) + reach_px + ROUNDING_PX
    outer = min(outer, PAD_PX - 1.0)
    inner = float(radius_px.min()) - reach_px - ROUNDING_PX
    span = np.arange(-int(outer), int(outer) + 1)
    dy, dx = np.meshgrid(span, span, indexing="ij")
    distance = np.hypot(dx, dy)
    chosen = (distance <= outer) & (distance >= inner)
    unit = np.linspace(-1.0, 1.0, 2001)
    curves = profile.level(unit * reach_px), -profile.slope(unit * reach_px)
    coefficients = np.zeros((2, POLYNOMIAL_DEGREE + 1))
    for row, curve in zip(coefficients, curves, strict=True):
        fitted = chebyshev.cheb2poly(chebyshev.chebfit(unit, curve, POLYNOMIAL_DEGREE))
        row[: len(fitted)] = fitted
    return FitWindow(
        offset=(dy[chosen] * row_px + dx[chosen]).astype(np.int64),
        dx=dx[chosen].astype(np.float32),
        dy=dy[chosen].astype(np.float32),
        coefficients=coefficients.astype(np.float32),
        reach_px=reach_px,
    )


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _normal_equations_kernel(
    level: NDArray[np.float32],
    dx: NDArray[np.float32],
    dy: NDArray[np.float32],
    center: tuple[np.float32, np.float32, np.float32],
    coefficients: NDArray[np.float32],
    scale: tuple[np.float32, np.float32],
    residual: NDArray[np.float32],
) -> tuple[float, ...]:  # pragma: no cover - compiled
    """Sum the robust normal equations of one marker; one straight loop, so that it vectorises.

    ``center`` is (x, y, radius) relative to the window, ``scale`` (1 / reach, 1 / soft^2).
    """
    x, y, radius = center
    per_reach, per_soft2 = scale
    one = np.float32(1.0)
    a = b = d = gx = gy = weight = total = np.float32(0.0)
    s0, s1, s2, s3, s4, s5, s6, s7 = coefficients[0, :8]
    s8, s9, s10, s11, s12, s13, s14, s15 = coefficients[0, 8:16]
    g0, g1, g2, g3, g4, g5, g6, g7 = coefficients[1, :8]
    g8, g9, g10, g11, g12, g13, g14, g15 = coefficients[1, 8:16]
    for j in range(level.size):
        ex = dx[j] - x
        ey = dy[j] - y
        inverse = one / np.sqrt(ex * ex + ey * ey + np.float32(1e-6))
        z = (one / inverse - radius) * per_reach
        z = one if z > one else z
        z = -one if z < -one else z
        high = s12 + z * (s13 + z * (s14 + z * s15))
        high = s8 + z * (s9 + z * (s10 + z * (s11 + z * high)))
        high = s4 + z * (s5 + z * (s6 + z * (s7 + z * high)))
        model = s0 + z * (s1 + z * (s2 + z * (s3 + z * high)))
        high = g12 + z * (g13 + z * (g14 + z * g15))
        high = g8 + z * (g9 + z * (g10 + z * (g11 + z * high)))
        high = g4 + z * (g5 + z * (g6 + z * (g7 + z * high)))
        slope = g0 + z * (g1 + z * (g2 + z * (g3 + z * high)))
        e = level[j] - model
        residual[j] = e
        w = one / (one + e * e * per_soft2)
        jx = slope * inverse * ex
        jy = slope * inverse * ey
        a += w * jx * jx
        b += w * jx * jy
        d += w * jy * jy
        gx += w * jx * e
        gy += w * jy * e
        weight += w * slope
        total += slope
    return a, b, d, gx, gy, weight, total


@njit(cache=True, nogil=True)
def fit_discs_kernel(
    padded: NDArray[np.float32],
    center_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    window: tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]],
    coefficients: NDArray[np.float32],
    reach_px: float,
    iterations: int,
    prior_px: NDArray[np.float64],
    prior_weight: float,
    agreement: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Move every centre to the best fit, in place.

    Args:
        padded: The map with its margin of PAD_PX.
        center_px: ``(m, 2)`` start and result, px.
        radius_px: ``(m,)`` radii, px.
        window: Offsets, columns and rows of :class:`FitWindow`.
        coefficients: Of :class:`FitWindow`.
        reach_px: Of :class:`FitWindow`, px.
        iterations: Gauss-Newton steps at most.
        prior_px: ``(m, 2)`` where the neighbours expect each marker, px.
        prior_weight: Weight of that prior as a share of the fit's own curvature.
        agreement: ``(m,)`` result: share of the edge that agrees with the fit, 0 to 1.
    """
    offset, dx, dy = window
    row_px = padded.shape[1]
    height, width = padded.shape[0] - 2 * PAD_PX, row_px - 2 * PAD_PX
    flat = padded.ravel()
    level = np.empty(offset.size, np.float32)
    residual = np.empty(offset.size, np.float32)
    scale = (np.float32(1.0 / reach_px), np.float32(1.0 / SOFT_LEVEL**2))
    for m in range(center_px.shape[0]):
        column = min(max(int(np.rint(center_px[m, 0])), 0), width - 1)
        row = min(max(int(np.rint(center_px[m, 1])), 0), height - 1)
        base = (row + PAD_PX) * row_px + column + PAD_PX
        for j in range(offset.size):
            level[j] = flat[base + offset[j]]
        x, y = center_px[m, 0] - column, center_px[m, 1] - row
        for _ in range(iterations):
            a, b, d, gx, gy, weight, total = _normal_equations_kernel(
                level,
                dx,
                dy,
                (np.float32(x), np.float32(y), np.float32(radius_px[m])),
                coefficients,
                scale,
                residual,
            )
            agreement[m] = weight / max(total, np.float32(1e-6))
            pull = prior_weight * 0.5 * (a + d)
            gx += pull * (prior_px[m, 0] - column - x)
            gy += pull * (prior_px[m, 1] - row - y)
            a, d = a + pull, d + pull
            determinant = a * d - b * b
            if not determinant > 1e-6:
                break
            step_x, step_y = (d * gx - b * gy) / determinant, (a * gy - b * gx) / determinant
            length = np.hypot(step_x, step_y)
            if length > LARGEST_STEP_PX:
                step_x *= LARGEST_STEP_PX / length
                step_y *= LARGEST_STEP_PX / length
            x += step_x
            y += step_y
            if length < SMALL_STEP_PX:
                break
        center_px[m, 0], center_px[m, 1] = column + x, row + y


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def leak_to_discs_kernel(
    padded: NDArray[np.float32],
    memory: NDArray[np.float32],
    center_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    table: NDArray[np.float32],
    table_scale: tuple[float, float, float],
    tolerance: float,
    share: float,
) -> None:  # pragma: no cover - compiled
    """Move map pixels that disagree with the fitted disc towards it.

    Noise and lost events leave errors in the sum that no later event removes; where the level is
    off by more than ``tolerance`` it gives up ``share`` of the excess. ``table`` is S, with
    ``table_scale`` = (reach, entries per px, outer reach): pixels beyond it are left alone.
    """
    reach_px, per_px, outer_px = table_scale
    height, width = memory.shape
    last = np.int64(table.size - 1)
    limit, portion = np.float32(tolerance), np.float32(share)
    zero, one, scale = np.float32(0.0), np.float32(1.0), np.float32(per_px)
    for m in range(center_px.shape[0]):
        x, y, radius = center_px[m, 0], center_px[m, 1], radius_px[m]
        outer = radius + outer_px
        start = np.float32(radius - reach_px)
        for row in range(max(0, int(np.ceil(y - outer))), min(height - 1, int(y + outer)) + 1):
            dy2 = np.float32((row - y) ** 2)
            half = np.sqrt(max(outer * outer - (row - y) ** 2, 0.0))
            first = max(0, int(np.ceil(x - half)))
            levels, sums = padded[row + PAD_PX, PAD_PX:], memory[row]
            for column in range(first, min(width - 1, int(x + half)) + 1):
                dx = np.float32(column - x)
                entry = np.int64(max((np.sqrt(dx * dx + dy2) - start) * scale, zero))
                e = levels[column] - table[min(entry, last)]
                if e > limit or e < -limit:
                    excess = e - limit if e > zero else e + limit
                    old = sums[column]
                    new = min(max(old - portion * excess, zero), one)
                    sums[column] = new
                    levels[column] += new - old
