"""What the levels left over say about each disc: its places, its stretch, and its shape.

Discs stretch with the skin, by 0.2 px on the twin: an edge that is common to all states would take
that for blur. So each state has its own growth of the radius and its own ellipse.

A pixel's offset is not known, so that only changes of its level between states count. The mean that
is taken off the levels left over is therefore taken off their derivatives too. Without that, a
shift that is common to all states hardly shows: a disc that never leaves some of its pixels stays
where it was first seen, a pixel or more away (simulated and recorded presses).
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
    PixelSteps,
    crowded_kernel,
    nearer_kernel,
    nearest_markers,
    profile_kernel,
    rim_px_kernel,
    stretched_kernel,
)
from spikingtac.markers.calibration.expected_levels import Walk
from spikingtac.markers.calibration.offset_memory import OffsetMemory
from spikingtac.state_map.two_threads import divide

RESIDUAL_LEVEL = 0.35  # Residuals beyond this level count less (Cauchy weights).

# Added to the curvature of a place at one state, of a shift of all places, of a radius and of an
# edge (1 / px^2), so that what the events hardly tell stays where it is. A marker that moves has
# 1,000 and more.
PLACE_PRIOR, SHIFT_PRIOR, RADIUS_PRIOR, EDGE_PRIOR = 1.0, 30.0, 100.0, 300.0

# The same for a stretch, but that draws it to none, since wide edges hardly tell it from a motion
# (1 / px^2, ours: not drawn, rests of a sensor like the recorded one err by half as much again;
# 1,000 is no better).
STRETCH_PRIOR = 200.0

# Rows of the derivatives that all states share, and those of one state: x, y, radius, edge, and
# the second harmonic of the radius.
COMMON, OWN = (0, 1, 2, 3), (0, 1, 2, 4, 5)


@dataclass(frozen=True, slots=True)
class Corrections:
    """One Gauss-Newton step of every disc.

    Attributes:
        move_px: ``(states, m, 2)`` how far each place is off at each state once the common shift
            is taken, px.
        stretch_px: ``(states, m, 3)`` how much each radius grows beside the others of its disc, and
            its second harmonic, px.
        common_px: ``(m, 4)`` shift of all places of a disc along x and y, and growth of its radius
            and of its edge, px.
        squares: ``(m,)`` weighted squares of the levels left over around each disc.
        weights: ``(m,)`` sums of these weights.
    """

    move_px: NDArray[np.float64]
    stretch_px: NDArray[np.float64]
    common_px: NDArray[np.float64]
    squares: NDArray[np.float64]
    weights: NDArray[np.float64]


def corrections(
    seen: Walk,
    shown: tuple[NDArray[np.float64], NDArray[np.float64]],
    discs: Discs,
    steps: PixelSteps,
    memory: OffsetMemory,
) -> Corrections:
    """Solve for one step of all discs.

    Args:
        seen: Real and ideal pixels at the states.
        shown: ``(states, m, 2)`` places at them and ``(states, m, 3)`` stretches, px.
        discs: How the markers look.
        steps: What one event of each pixel stands for.
        memory: Which states tell a pixel's offset.
    """
    places, stretch_px = shown
    states, markers = places.shape[:2]
    out = Corrections(
        np.zeros((states, markers, 2)),
        np.zeros((states, markers, 3)),
        np.zeros((markers, 4)),
        *np.zeros((2, markers)),
    )
    shapes = np.array([stretched_kernel(discs.shape, stretch) for stretch in stretch_px])
    scene = (places, nearest_markers(places[0]), shapes)
    reach_px = discs.radius_px + OUTSIDE_EDGES * discs.edge_px + MARGIN_PX

    def correct(chosen: slice) -> None:
        for marker in range(*chosen.indices(markers)):
            window = _window(places[:, marker], float(reach_px[marker]), steps.on.shape)
            slopes = np.zeros((6, states, *steps.on[window].shape), np.float32)
            if not slopes.size:
                continue
            slopes_kernel(scene, marker, (window[0].start, window[1].start), slopes)
            flat = slopes.reshape(6, states, -1)
            left_over = _cut(seen.measured, window) - _cut(seen.expected, window)
            spread = (steps.on[window] ** 2 + steps.off[window] ** 2).ravel() / 12.0
            known = LEVEL_VARIANCE + spread, stretch_px[:, marker]
            _solve(left_over, flat, (_cut(seen.drawn, window), memory), known, (marker, out))

    divide(markers, correct)
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
    known: tuple[NDArray[np.float32], NDArray[np.float64]],
    out: tuple[int, Corrections],
) -> None:
    # First what all states share, with offsets taken off; then each state from what is left.
    (drawn, memory), (variance, stretch_px) = offsets, known
    marker, found = out
    changes = memory.changes(np.concatenate([left_over[np.newaxis], slopes[: len(COMMON)]]), drawn)
    error, shared = changes[0], changes[1:]
    weight = np.empty_like(error)
    curvature, pull = np.diag([SHIFT_PRIOR, SHIFT_PRIOR, RADIUS_PRIOR, EDGE_PRIOR]), np.zeros(4)
    found.squares[marker], found.weights[marker] = common_sums_kernel(
        error, slopes[2], variance, (shared, weight), (curvature, pull)
    )
    curvature += np.tril(curvature, -1).T
    common = np.asarray(np.linalg.solve(curvature, pull), np.float64)
    found.common_px[marker] = common
    prior = np.array([PLACE_PRIOR, PLACE_PRIOR, *[STRETCH_PRIOR] * 3])
    curvatures, pulls = np.tile(np.diag(prior), (len(error), 1, 1)), np.zeros((len(error), 5))
    pulls[:, 2:] = -STRETCH_PRIOR * stretch_px
    state_sums_kernel(error, weight, slopes[list(OWN)], (shared, common), (curvatures, pulls))
    own = np.linalg.solve(curvatures, pulls[..., np.newaxis])[..., 0]
    found.move_px[:, marker] = own[:, :2]
    # What all states grow by is the radius'.
    found.stretch_px[:, marker] = own[:, 2:] - [own[:, 2].mean(), 0.0, 0.0]


@njit(cache=True, nogil=True)
def common_sums_kernel(
    error: NDArray[np.float32],
    near: NDArray[np.float32],
    variance: NDArray[np.float32],
    fields: tuple[NDArray[np.float32], NDArray[np.float32]],
    out: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> tuple[float, float]:
    """Add up the normal equations of what all states share; return weighted squares and weights.

    Args:
        error: ``(states, pixels)`` levels left over.
        near: The same shape; zero where a pixel tells nothing of the disc.
        variance: ``(pixels,)`` variance of a level.
        fields: Derivatives ``(4, states, pixels)``, and weights ``(states, pixels)`` to fill.
        out: Curvature ``(4, 4)``, its lower triangle, and right-hand side ``(4,)`` to add to.
    """
    shared, weight = fields
    curvature, pull = out
    squares = weights = 0.0
    row = np.empty(4)
    for state in range(error.shape[0]):
        for q in range(error.shape[1]):
            weight[state, q] = 0.0
            if near[state, q] == 0.0:
                continue
            value = np.float64(error[state, q])
            w = 1.0 / (variance[q] * (1.0 + (value / RESIDUAL_LEVEL) ** 2))
            weight[state, q] = w
            weights += w
            squares += w * value * value
            for i in range(4):
                row[i] = shared[i, state, q]
                pull[i] += w * row[i] * value
                for j in range(i + 1):
                    curvature[i, j] += w * row[i] * row[j]
    return squares, weights


@njit(cache=True, nogil=True)
def state_sums_kernel(
    error: NDArray[np.float32],
    weight: NDArray[np.float32],
    slopes: NDArray[np.float32],
    common: tuple[NDArray[np.float32], NDArray[np.float64]],
    out: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Add up each state's own normal equations, from what the common step leaves.

    Args:
        error: ``(states, pixels)`` levels left over.
        weight: Their weights.
        slopes: ``(k, states, pixels)`` derivatives.
        common: The derivatives ``(4, states, pixels)`` of the common step, and that step ``(4,)``.
        out: Curvatures ``(states, k, k)`` and right-hand sides ``(states, k)`` to add to.
    """
    shared, step = common
    curvatures, pulls = out
    own = len(slopes)
    row = np.empty(own)
    for state in range(error.shape[0]):
        for q in range(error.shape[1]):
            w = np.float64(weight[state, q])
            if w == 0.0:
                continue
            left = np.float64(error[state, q])
            for i in range(4):
                left -= step[i] * shared[i, state, q]
            for i in range(own):
                row[i] = slopes[i, state, q]
                pulls[state, i] += w * row[i] * left
                for j in range(i + 1):
                    curvatures[state, i, j] += w * row[i] * row[j]
        for i in range(own):
            for j in range(i):
                curvatures[state, j, i] = curvatures[state, i, j]


@njit(cache=True, nogil=True)
def slopes_kernel(
    scene: tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]],
    m: int,
    corner: tuple[int, int],
    out: NDArray[np.float32],
) -> None:
    """Fill in by how much each pixel's level rises per px of a disc's x, y, radius, edge, stretch.

    Args:
        scene: Places ``(states, m, 2)``, nearest others ``(m, k)`` and shapes ``(states, m, 5)``.
        m: The disc.
        corner: First row and first column of the window.
        out: ``(6, states, rows, columns)`` zeros; pixels away from the rim, and those nearer to
            another rim, keep them.
    """
    places, nearest, shapes = scene
    for state in range(len(places)):
        shape = shapes[state]
        radius, edge, k = shape[m, 0], shape[m, 1], shape[m, 2]
        outer = OUTSIDE_EDGES * edge + MARGIN_PX
        cx, cy = places[state, m, 0], places[state, m, 1]
        at_state = (places[state], nearest, shape)
        crowded = crowded_kernel(m, places[state, m], radius + outer, at_state)
        for row in range(out.shape[2]):
            for column in range(out.shape[3]):
                x, y = corner[1] + column, corner[0] + row
                dx, dy = x - cx, y - cy
                rho = np.sqrt(dx * dx + dy * dy)
                q = rho - rim_px_kernel(shape, m, dx, dy)
                if q > outer or rho < 0.5:
                    continue
                if crowded and nearer_kernel(x, y, q, m, at_state):
                    continue
                _, slope = profile_kernel(q / edge, edge, k)
                out[0, state, row, column] = slope * dx / rho
                out[1, state, row, column] = slope * dy / rho
                out[2, state, row, column] = slope
                out[3, state, row, column] = slope * q / edge
                out[4, state, row, column] = slope * (dx * dx - dy * dy) / (rho * rho)
                out[5, state, row, column] = slope * 2.0 * dx * dy / (rho * rho)
