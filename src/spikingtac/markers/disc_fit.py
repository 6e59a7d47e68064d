"""Fit a disc's centre to the graded map, by a few robust Gauss-Newton steps per marker.

Residual e = Y(x) - S(|x - c| - R(phi)) over the pixels around the edge, weight
1 / (1 + (e / soft)^2) (Cauchy), S of :mod:`spikingtac.markers.profile` as a polynomial, which the
compiler can vectorise where it cannot vectorise a table or an exponential. Each pass is three
straight loops over the pixels: in one loop the sums would not fit into the registers. The outline
R(phi) = r + b cos 2 phi + c sin 2 phi follows the disc slowly: an indentation magnifies it, strain
makes it an ellipse. Both are even in phi and leave the centre alone, but a map that is held to the
wrong outline would not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from spikingtac.markers.profile import DiscProfile
from spikingtac.state_map.graded import PAD_PX

POLYNOMIAL_DEGREE = 15
"""S within 0.0005 and dS/dq within 0.004 per px of the formula at contrast 6."""

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


def round_outline(radius_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(m, 3)`` outlines of round discs: the radius, and no second harmonic, px."""
    return np.column_stack([radius_px, np.zeros((len(radius_px), 2))])


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _polynomial_kernel(c: NDArray[np.float32], z: Any) -> Any:  # pragma: no cover
    """Evaluate a polynomial of degree 15 by Estrin's scheme: Horner's waits for each product."""
    z2 = z * z
    z4 = z2 * z2
    low = (c[0] + c[1] * z) + z2 * (c[2] + c[3] * z)
    low += z4 * ((c[4] + c[5] * z) + z2 * (c[6] + c[7] * z))
    high = (c[8] + c[9] * z) + z2 * (c[10] + c[11] * z)
    high += z4 * ((c[12] + c[13] * z) + z2 * (c[14] + c[15] * z))
    return low + z4 * z4 * high


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _edge_kernel(
    pixels: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    state: NDArray[np.float32],
    coefficients: NDArray[np.float32],
    per_reach: np.float32,
    edge: tuple[NDArray[np.float32], ...],
) -> None:  # pragma: no cover - compiled
    """Write each pixel's direction (x, y) from the centre, its residual, and the slope there.

    ``state`` is (x, y, r, b, c) relative to the window. Two loops, since one with four outputs is
    not vectorised.
    """
    level, dx, dy = pixels
    ux, uy, residual, slope = edge
    x, y, r, b, c = state[0], state[1], state[2], state[3], state[4]
    curve, steep = coefficients[0], coefficients[1]
    one = np.float32(1.0)
    for j in range(level.size):
        across, down = dx[j] - x, dy[j] - y
        rho2 = across * across + down * down + np.float32(1e-6)
        inverse = one / np.sqrt(rho2)
        to_x, to_y = across * inverse, down * inverse
        bulge = b * (to_x * to_x - to_y * to_y) + c * np.float32(2.0) * to_x * to_y
        z = (rho2 * inverse - r - bulge) * per_reach
        z = one if z > one else z
        slope[j] = -one if z < -one else z
        ux[j], uy[j] = to_x, to_y
    for j in range(level.size):
        z = slope[j]
        residual[j] = level[j] - _polynomial_kernel(curve, z)
        slope[j] = _polynomial_kernel(steep, z)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _normal_equations_kernel(
    edge: tuple[NDArray[np.float32], ...],
    moved_x: np.float32,
    moved_y: np.float32,
    per_soft2: np.float32,
) -> tuple[Any, ...]:  # pragma: no cover - compiled
    """Sum the robust normal equations of one marker; one straight loop, so that it vectorises.

    ``moved`` is how far the centre went since ``edge`` was read, px; ``per_soft2`` is 1 / soft^2.
    Returns the curvature (xx, xy, yy), the gradients (x, y, r, b, c), the curvature of r, and the
    share of the edge that agrees.
    """
    ux, uy, residual, slope = edge
    one = np.float32(1.0)
    xx = xy = yy = gx = gy = gr = gb = gc = rr = weight = total = np.float32(0.0)
    for j in range(ux.size):
        to_x, to_y, s = ux[j], uy[j], slope[j]
        e = residual[j] - s * (to_x * moved_x + to_y * moved_y)
        ws = s / (one + e * e * per_soft2)
        wse = ws * e
        wss = ws * s
        xx += wss * to_x * to_x
        xy += wss * to_x * to_y
        yy += wss * to_y * to_y
        gx += wse * to_x
        gy += wse * to_y
        gr += wse
        gb += wse * (to_x * to_x - to_y * to_y)
        gc += wse * (np.float32(2.0) * to_x * to_y)
        rr += wss
        weight += ws
        total += s
    return xx, xy, yy, gx, gy, gr, gb, gc, rr, weight / (total + np.float32(1e-6))


@njit(cache=True, nogil=True)
def _center_step_kernel(
    curvature: tuple[Any, Any, Any], gx: Any, gy: Any
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Solve the 2x2 system, cut to LARGEST_STEP_PX; no step where the edge says nothing."""
    xx, xy, yy = curvature
    determinant = xx * yy - xy * xy
    if not determinant > 1e-6:
        return 0.0, 0.0
    step_x, step_y = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
    length = np.hypot(step_x, step_y)
    if length > LARGEST_STEP_PX:
        return step_x * LARGEST_STEP_PX / length, step_y * LARGEST_STEP_PX / length
    return step_x, step_y


@njit(cache=True, nogil=True)
def _fit_one_kernel(
    pixels: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    edge: tuple[NDArray[np.float32], ...],
    state: NDArray[np.float32],
    curves: tuple[NDArray[np.float32], float, int],
    prior: tuple[float, float, float],
    outline_gain: float,
) -> float:  # pragma: no cover - compiled
    """Move one marker's centre to the best fit, and its outline a little; return the agreement.

    ``pixels`` are levels, columns and rows, ``edge`` is scratch, ``prior`` the expected x and y and
    their weight.
    """
    coefficients, reach_px, iterations = curves
    per_soft2 = np.float32(1.0 / SOFT_LEVEL**2)
    gr = gb = gc = rr = agreement = moved_x = moved_y = np.float32(0.0)
    fresh = False
    for _ in range(iterations):
        if not fresh:
            _edge_kernel(pixels, state, coefficients, np.float32(1.0 / reach_px), edge)
            moved_x = moved_y = np.float32(0.0)
        xx, xy, yy, gx, gy, gr, gb, gc, rr, agreement = _normal_equations_kernel(
            edge, moved_x, moved_y, per_soft2
        )
        pull = prior[2] * 0.5 * (xx + yy)
        gx += pull * (prior[0] - state[0])
        gy += pull * (prior[1] - state[1])
        step_x, step_y = _center_step_kernel((xx + pull, xy, yy + pull), gx, gy)
        state[0] += step_x
        state[1] += step_y
        moved_x += np.float32(step_x)
        moved_y += np.float32(step_y)
        if step_x * step_x + step_y * step_y < SMALL_STEP_PX * SMALL_STEP_PX:
            break
        fresh = moved_x * moved_x + moved_y * moved_y < LINEAR_STEP_PX * LINEAR_STEP_PX
    gain = outline_gain / (rr + 1e-3)
    state[2] += gain * gr
    state[3] += 2.0 * gain * gb
    state[4] += 2.0 * gain * gc
    return float(agreement)


@njit(cache=True, nogil=True)
def fit_discs_kernel(
    padded: NDArray[np.float32],
    center_px: NDArray[np.float64],
    outline_px: NDArray[np.float64],
    window: tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]],
    curves: tuple[NDArray[np.float32], float, int],
    prior: tuple[NDArray[np.float64], float],
    outline_gain: float,
    agreement: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Move every centre to the best fit and every outline a little, in place.

    Args:
        padded: The map with its margin of PAD_PX.
        center_px: ``(m, 2)`` start and result, px.
        outline_px: ``(m, 3)`` r, b and c of each disc, px.
        window: Offsets, columns and rows of :class:`FitWindow`.
        curves: Coefficients and reach (px) of :class:`FitWindow`; Gauss-Newton steps at most.
        prior: ``(m, 2)`` where the neighbours expect each marker, px, and its weight as a share of
            the fit's own curvature.
        outline_gain: Share of its Gauss-Newton step that the outline makes.
        agreement: ``(m,)`` result: share of the edge that agrees with the fit, 0 to 1.
    """
    offset, dx, dy = window
    row_px = padded.shape[1]
    flat = padded.ravel()
    level = np.empty(offset.size, np.float32)
    scratch = np.empty((4, offset.size), np.float32)
    edge = (scratch[0], scratch[1], scratch[2], scratch[3])
    state = np.empty(5, np.float32)
    for m in range(center_px.shape[0]):
        column = min(max(int(np.rint(center_px[m, 0])), 0), row_px - 2 * PAD_PX - 1)
        row = min(max(int(np.rint(center_px[m, 1])), 0), padded.shape[0] - 2 * PAD_PX - 1)
        base = (row + PAD_PX) * row_px + column + PAD_PX
        for j in range(offset.size):
            level[j] = flat[base + offset[j]]
        state[0], state[1] = center_px[m, 0] - column, center_px[m, 1] - row
        for k in range(3):  # a slice assignment would compile for seconds, and runs no faster
            state[2 + k] = outline_px[m, k]
        expected = (prior[0][m, 0] - column, prior[0][m, 1] - row, prior[1])
        agreement[m] = _fit_one_kernel((level, dx, dy), edge, state, curves, expected, outline_gain)
        center_px[m, 0], center_px[m, 1] = column + state[0], row + state[1]
        for k in range(3):
            outline_px[m, k] = state[2 + k]
