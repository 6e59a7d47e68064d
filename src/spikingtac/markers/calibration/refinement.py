"""Explain all events at once: places, radii, edges and steps, refined in turn.

The levels that the real pixels reached are compared with those that ideal ones reach along the same
course (:mod:`spikingtac.markers.calibration.expected_levels`). What is left over at a state moves
each disc and changes its shape by one Gauss-Newton step; then the ideal pixels walk again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.disc_levels import (
    LEVEL_VARIANCE,
    MARGIN_PX,
    OUTSIDE_EDGES,
    Discs,
    bounds_kernel,
    crowded_kernel,
    nearer_kernel,
    nearest_markers,
    profile_kernel,
)
from spikingtac.markers.calibration.expected_levels import Walk, walk
from spikingtac.markers.calibration.following import Course, PixelSteps

ROUNDS = 10
"""Times that the ideal pixels walk: places move by less than 0.01 px after it (simulated)."""

MOST_STATES, MOST_STATE_PIXELS = 80, 12_000_000
"""States that are compared, and their pixels together: each pixel of each takes some 40 bytes."""

PLACE_GAIN, SHAPE_GAIN, COUNT_GAIN = 1.5, 0.8, 0.5
"""Shares of a step that are taken. A part of each residual is absorbed by the pixels' offsets, so
that places converge fastest when a step is exceeded (1.5 of 1, 1.5 and 2 tried)."""

LARGEST_MOVE_PX, LARGEST_GROWTH_PX = 1.0, 0.3
"""Bounds of one round's change of a place, and of a radius or an edge, px."""

EDGE_BOUNDS_PX = (0.3, 2.0)
"""Least and largest edge width that is believed, px."""

RADIUS_SHARES = (0.5, 1.6)
"""Bounds of a radius, as shares of the first guess."""

RESIDUAL_LEVEL = 0.35
"""Residuals beyond this level count less (Cauchy weights)."""

PLACE_PRIOR, RADIUS_PRIOR, EDGE_PRIOR, COUNT_PRIOR = 1.0, 100.0, 300.0, 100.0
"""Added to the curvature of a place, a radius and an edge (1 / px^2), and to counts of events, so
that what the events hardly tell stays where it is. A marker that moves has 1,000 and more."""


@dataclass(frozen=True, slots=True)
class Refined:
    """All that explains the events.

    Attributes:
        course: Where the markers went.
        states: ``(k,)`` samples at which real and ideal pixels were compared.
        discs: How the markers look.
        on: ``(m,)`` share of a full swing of each marker's ON event.
        off: The same for OFF events.
        pixel: The same for each pixel.
        residual: ``(m,)`` rms of the levels left over around each marker.
        curvature: ``(m,)`` how well a marker's place is determined, 1 / px^2, all states together.
        events: ``(m, 4)`` events near each marker: real ON and OFF, expected ON and OFF.
    """

    course: Course
    states: NDArray[np.int64]
    discs: Discs
    on: NDArray[np.float64]
    off: NDArray[np.float64]
    pixel: PixelSteps
    residual: NDArray[np.float64]
    curvature: NDArray[np.float64]
    events: NDArray[np.float64]


def refine(
    events: BufferedEvents,
    start: Refined,
    still: NDArray[np.int64],
    cell: NDArray[np.int64],
    noise: NDArray[np.float64],
) -> Refined:
    """Return everything refined.

    Args:
        events: The recording, markers brighter than the ground.
        start: Where to begin; its states are the samples to compare.
        still: ``(rests, 3)`` first, typical and last sample of each rest: nothing moves in it.
        cell: Nearest marker of each pixel, row by row.
        noise: ``(2,)`` ON and OFF events that are expected near a marker without any motion.
    """
    at = start
    first_radius_px = start.discs.radius_px
    for _ in range(ROUNDS):
        at = replace(at, course=_frozen(at.course, still))
        seen = walk(events, at.course, at.states, at.discs, at.pixel)
        error = seen.left_over()
        markers = len(first_radius_px)
        move = np.zeros((len(at.states), markers, 3))
        shape = np.zeros((markers, 7))
        places = at.course.center_px[at.states]
        corrections_kernel(
            error,
            places,
            (at.discs.shape, nearest_markers(places[0])),
            (at.pixel.on, at.pixel.off),
            (move, shape),
        )
        at = _stepped(at, (move, shape), first_radius_px)
        at = _recounted(at, seen, cell, noise)
    return replace(at, course=_frozen(at.course, still))


def choose_states(samples: int, still: NDArray[np.int64], pixels: int) -> NDArray[np.int64]:
    """Return the samples to compare: one of each rest, and others evenly in between."""
    most = max(min(MOST_STATES, MOST_STATE_PIXELS // pixels), len(still) + 2)
    even = np.linspace(0, samples - 1, most - len(still)).astype(np.int64)
    if len(still):
        apart = np.abs(even[:, np.newaxis] - still[np.newaxis, :, 1]).min(axis=1)
        even = even[apart > 0.5 * samples / most]
    return np.unique(np.concatenate([even, still[:, 1]]))


def _frozen(course: Course, still: NDArray[np.int64]) -> Course:
    center_px = course.center_px.copy()
    for first, typical, last in still:
        center_px[first : last + 1] = center_px[typical]
    return replace(course, center_px=center_px)


def _stepped(
    at: Refined,
    found: tuple[NDArray[np.float64], NDArray[np.float64]],
    first_radius_px: NDArray[np.float64],
) -> Refined:
    move, shape = found
    change = PLACE_GAIN * move[..., :2]
    length = np.linalg.norm(change, axis=2, keepdims=True)
    change *= np.minimum(1.0, LARGEST_MOVE_PX / np.maximum(length, 1e-9))
    center_px = at.course.center_px.copy()
    samples = np.arange(len(center_px))
    for marker in range(center_px.shape[1]):
        for axis in (0, 1):
            center_px[:, marker, axis] += np.interp(samples, at.states, change[:, marker, axis])
    rr, rs, ss, r, s = (shape[:, i] for i in range(5))
    rr, ss = rr + RADIUS_PRIOR, ss + EDGE_PRIOR
    det = rr * ss - rs * rs
    growth = SHAPE_GAIN * np.array([(ss * r - rs * s) / det, (rr * s - rs * r) / det])
    growth = growth.clip(-LARGEST_GROWTH_PX, LARGEST_GROWTH_PX)
    low, high = (share * first_radius_px for share in RADIUS_SHARES)
    discs = at.discs.with_shape(
        (at.discs.radius_px + growth[0]).clip(low, high),
        (at.discs.edge_px + growth[1]).clip(*EDGE_BOUNDS_PX),
    )
    return replace(
        at,
        course=replace(at.course, center_px=center_px),
        discs=discs,
        residual=np.sqrt(shape[:, 5] / np.maximum(shape[:, 6], 1e-9)),
        curvature=move[..., 2].sum(axis=0),
    )


def _recounted(
    at: Refined, seen: Walk, cell: NDArray[np.int64], noise: NDArray[np.float64]
) -> Refined:
    # Fewer events than expected: each stands for more.
    real = (seen.events[:, :2] - noise).clip(0.0) + COUNT_PRIOR
    factor = ((seen.events[:, 2:] + COUNT_PRIOR) / real) ** COUNT_GAIN
    factor = factor.clip(0.8, 1.25)
    shape = at.pixel.on.shape
    pixel = PixelSteps(
        (at.pixel.on.ravel() * factor[cell, 0]).clip(0.01, 1.0).reshape(shape).astype(np.float32),
        (at.pixel.off.ravel() * factor[cell, 1]).clip(0.01, 1.0).reshape(shape).astype(np.float32),
    )
    return replace(
        at,
        on=(at.on * factor[:, 0]).clip(0.01, 1.0),
        off=(at.off * factor[:, 1]).clip(0.01, 1.0),
        pixel=pixel,
        events=seen.events,
    )


@njit(cache=True)
def corrections_kernel(
    error: NDArray[np.float32],
    places: NDArray[np.float64],
    discs: tuple[NDArray[np.float64], NDArray[np.int64]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    out: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Solve for each disc's move at each state; sum the normal equations of its shape.

    ``out`` is ``(states, m, 3)`` move (px) and its curvature, and ``(m, 7)``: radius-radius,
    radius-edge, edge-edge, radius, edge, squared residuals, weights.
    """
    move, shape_sums = out
    sums = np.zeros(5)
    for state in range(len(places)):
        for m in range(places.shape[1]):
            sums[:] = 0.0
            scene = (places[state], discs[1], discs[0])
            add_rim_kernel(error[state], steps, m, scene, (sums, shape_sums[m]))
            xx, xy, yy = sums[0] + PLACE_PRIOR, sums[1], sums[2] + PLACE_PRIOR
            det = xx * yy - xy * xy
            move[state, m, 0] = (yy * sums[3] - xy * sums[4]) / det
            move[state, m, 1] = (xx * sums[4] - xy * sums[3]) / det
            move[state, m, 2] = min(sums[0], sums[2])


@njit(cache=True)
def add_rim_kernel(
    error: NDArray[np.float32],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    m: int,
    scene: tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]],
    out: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Add one disc's pixels at one state to its normal equations."""
    place, sums = out
    height, width = error.shape
    cx, cy = scene[0][m, 0], scene[0][m, 1]
    radius, edge, k = scene[2][m]
    outer = OUTSIDE_EDGES * edge + MARGIN_PX
    top, bottom = bounds_kernel(cy, radius + outer, height)
    left, right = bounds_kernel(cx, radius + outer, width)
    crowded = crowded_kernel(m, scene[0][m], radius + outer, scene)
    for y in range(top, bottom):
        for x in range(left, right):
            dx, dy = x - cx, y - cy
            rho = np.sqrt(dx * dx + dy * dy)
            q = rho - radius
            if q > outer or rho < 0.5 or (crowded and nearer_kernel(x, y, q, m, scene)):
                continue
            _, slope = profile_kernel(q / edge, edge, k)
            left_over = error[y, x]
            variance = LEVEL_VARIANCE + (steps[0][y, x] ** 2 + steps[1][y, x] ** 2) / 12.0
            weight = 1.0 / variance / (1.0 + (left_over / RESIDUAL_LEVEL) ** 2)
            gx, gy, gs = slope * dx / rho, slope * dy / rho, slope * q / edge
            place[0] += weight * gx * gx
            place[1] += weight * gx * gy
            place[2] += weight * gy * gy
            place[3] += weight * gx * left_over
            place[4] += weight * gy * left_over
            sums[0] += weight * slope * slope
            sums[1] += weight * slope * gs
            sums[2] += weight * gs * gs
            sums[3] += weight * slope * left_over
            sums[4] += weight * gs * left_over
            sums[5] += weight * left_over * left_over
            sums[6] += weight
