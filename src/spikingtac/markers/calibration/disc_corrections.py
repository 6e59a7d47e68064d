"""What the levels left over say about each disc: its places, and its shape.

A pixel's offset is not known, so that only changes of its level between states count. The mean that
is taken off the levels left over is therefore taken off their derivatives too. Without that, a
shift that is common to all states hardly shows: a disc that never leaves some of its pixels stays
where it was first seen, a pixel or more away (ours: simulated and recorded presses).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.disc_levels import (
    LEVEL_VARIANCE,
    MARGIN_PX,
    OUTSIDE_EDGES,
    Discs,
    crowded_kernel,
    nearer_kernel,
    nearest_markers,
    profile_kernel,
)
from spikingtac.markers.calibration.expected_levels import OffsetMemory, Walk
from spikingtac.markers.calibration.following import PixelSteps

RESIDUAL_LEVEL = 0.35
"""Residuals beyond this level count less (Cauchy weights)."""

PLACE_PRIOR, SHIFT_PRIOR, RADIUS_PRIOR, EDGE_PRIOR = 1.0, 30.0, 100.0, 300.0
"""Added to the curvature of a place at one state, of a shift of all places, of a radius and of an
edge (1 / px^2), so that what the events hardly tell stays where it is. A marker that moves has
1,000 and more."""


@dataclass(frozen=True, slots=True)
class Corrections:
    """One Gauss-Newton step of every disc.

    Attributes:
        move_px: ``(states, m, 2)`` how far each place is off at each state once the common shift
            is taken, px.
        common_px: ``(m, 4)`` shift of all places of a disc along x and y, and growth of its radius
            and of its edge, px.
        squares: ``(m,)`` weighted squares of the levels left over around each disc.
        weights: ``(m,)`` sums of these weights.
    """

    move_px: NDArray[np.float64]
    common_px: NDArray[np.float64]
    squares: NDArray[np.float64]
    weights: NDArray[np.float64]


def corrections(
    seen: Walk,
    places: NDArray[np.float64],
    discs: Discs,
    steps: PixelSteps,
    memory: OffsetMemory,
) -> Corrections:
    """Solve for one step of all discs.

    Args:
        seen: Real and ideal pixels at the states.
        places: ``(states, m, 2)`` places at them, px.
        discs: How the markers look.
        steps: What one event of each pixel stands for.
        memory: Which states tell a pixel's offset.
    """
    states, markers = places.shape[:2]
    out = Corrections(
        np.zeros((states, markers, 2)), np.zeros((markers, 4)), *np.zeros((2, markers))
    )
    scene = (places, nearest_markers(places[0]), discs.shape)
    reach_px = discs.radius_px + OUTSIDE_EDGES * discs.edge_px + MARGIN_PX
    for marker in range(markers):
        window = _window(places[:, marker], float(reach_px[marker]), steps.on.shape)
        slopes = np.zeros((4, states, *steps.on[window].shape), np.float32)
        if not slopes.size:
            continue
        slopes_kernel(scene, marker, (window[0].start, window[1].start), slopes)
        flat = slopes.reshape(4, states, -1)
        left_over = _cut(seen.measured, window) - _cut(seen.expected, window)
        variance = LEVEL_VARIANCE + (steps.on[window] ** 2 + steps.off[window] ** 2).ravel() / 12.0
        _solve(left_over, flat, (_cut(seen.drawn, window), memory), variance, (marker, out))
    return out


def _window(
    place_px: NDArray[np.float64], reach_px: float, shape: tuple[int, ...]
) -> tuple[slice, slice]:
    # Rows and columns of the pixels that a disc reaches at any state.
    size = np.array(shape[::-1])
    first = np.floor(place_px.min(axis=0) - reach_px).astype(int).clip(0, size)
    last = (np.ceil(place_px.max(axis=0) + reach_px).astype(int) + 1).clip(first, size)
    return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))


def _cut(images: NDArray[np.float32], window: tuple[slice, slice]) -> NDArray[np.float32]:
    return images[(slice(None), *window)].reshape(len(images), -1)


def _solve(
    left_over: NDArray[np.float32],
    slopes: NDArray[np.float32],
    offsets: tuple[NDArray[np.float32], OffsetMemory],
    variance: NDArray[np.float32],
    out: tuple[int, Corrections],
) -> None:
    # First what all states share, with offsets taken off; then each state from what is left.
    drawn, memory = offsets
    marker, found = out
    error = memory.changes(left_over, drawn).astype(np.float64)
    near = slopes[2] != 0.0
    weight = near / variance / (1.0 + (error / RESIDUAL_LEVEL) ** 2)
    found.squares[marker] = (weight * error**2).sum()
    found.weights[marker] = weight.sum()
    shared = np.array([memory.changes(slope, drawn) for slope in slopes], np.float64).reshape(4, -1)
    curvature = (shared * weight.ravel()) @ shared.T
    curvature += np.diag([SHIFT_PRIOR, SHIFT_PRIOR, RADIUS_PRIOR, EDGE_PRIOR])
    common = np.linalg.solve(curvature, shared @ (weight * error).ravel())
    found.common_px[marker] = common
    error -= (common @ shared).reshape(error.shape)
    gx, gy = slopes[:2].astype(np.float64)
    xx, yy = ((weight * g * g).sum(axis=1) + PLACE_PRIOR for g in (gx, gy))
    xy, x, y = ((weight * g).sum(axis=1) for g in (gx * gy, gx * error, gy * error))
    det = xx * yy - xy * xy
    found.move_px[:, marker, 0] = (yy * x - xy * y) / det
    found.move_px[:, marker, 1] = (xx * y - xy * x) / det


@njit(cache=True)
def slopes_kernel(
    scene: tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]],
    m: int,
    corner: tuple[int, int],
    out: NDArray[np.float32],
) -> None:
    """Fill in by how much each pixel's level rises per px of a disc's x, y, radius and edge.

    Args:
        scene: Places ``(states, m, 2)``, nearest others ``(m, k)`` and shapes ``(m, 3)``.
        m: The disc.
        corner: First row and first column of the window.
        out: ``(4, states, rows, columns)`` zeros; pixels away from the rim, and those nearer to
            another rim, keep them.
    """
    places, nearest, shape = scene
    radius, edge, k = shape[m]
    outer = OUTSIDE_EDGES * edge + MARGIN_PX
    for state in range(len(places)):
        cx, cy = places[state, m, 0], places[state, m, 1]
        at_state = (places[state], nearest, shape)
        crowded = crowded_kernel(m, places[state, m], radius + outer, at_state)
        for row in range(out.shape[2]):
            for column in range(out.shape[3]):
                x, y = corner[1] + column, corner[0] + row
                dx, dy = x - cx, y - cy
                rho = np.sqrt(dx * dx + dy * dy)
                q = rho - radius
                if q > outer or rho < 0.5:
                    continue
                if crowded and nearer_kernel(x, y, q, m, at_state):
                    continue
                _, slope = profile_kernel(q / edge, edge, k)
                out[0, state, row, column] = slope * dx / rho
                out[1, state, row, column] = slope * dy / rho
                out[2, state, row, column] = slope
                out[3, state, row, column] = slope * q / edge
