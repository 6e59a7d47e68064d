"""Explain all events at once: places, radii, edges and steps, refined in turn.

The levels that the real pixels reached are compared with those that ideal ones reach along the same
course (:mod:`.expected_levels`). What is left over moves each disc and changes its shape by one
Gauss-Newton step (:mod:`.disc_corrections`); then the ideal pixels walk again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.disc_corrections import (
    RESIDUAL_LEVEL,
    Corrections,
    corrections,
)
from spikingtac.markers.calibration.disc_levels import Course, Discs, PixelSteps
from spikingtac.markers.calibration.expected_levels import Walk, walk
from spikingtac.markers.calibration.offset_memory import RIM_LEVELS, OffsetMemory
from spikingtac.markers.calibration.recording import BufferedEvents
from spikingtac.state_map.two_threads import divide

# Times that the ideal pixels walk at most. Wide edges take many rounds: they grow by 0.1 px in
# each.
MOST_ROUNDS = 10

# The refinement ends when most places and shapes change by less than this in a round.
SETTLED_PX = 0.01

# States that are compared, and their pixels together: each pixel of each takes some 40 bytes.
MOST_STATES, MOST_STATE_PIXELS = 80, 12_000_000

# Shares of a step that are taken. A part of each residual is absorbed by the pixels' offsets, so
# that places converge fastest when a step is exceeded (1.5 of 1, 1.5 and 2 tried).
PLACE_GAIN, SHAPE_GAIN, COUNT_GAIN = 1.5, 0.8, 0.5

LEAST_GAIN = 0.5  # Full swings that add up to less than this are no swings of that marker.

# Bounds of one round's change of a place, and of a radius or an edge, px.
LARGEST_MOVE_PX, LARGEST_GROWTH_PX = 1.0, 0.3

# Bound of a stretch: the twin's discs, of 6.8 px, are stretched by 0.2 px under slides.
LARGEST_STRETCH_PX = 1.0

# Least and largest edge width that is believed, px. The recorded sensor has 1.3 to 2.3.
EDGE_BOUNDS_PX = (0.3, 3.0)

RADIUS_SHARES = (0.5, 1.6)  # Bounds of a radius, as shares of the first guess.

COUNT_PRIOR = 100.0  # Added to counts of events, so that few of them change little.

# Offsets drift within few states: real pixels lose a fifth of a swing over a rest of seconds. Of
# 2 to 100 states, 2 to 10 are equally good on simulated and recorded presses.
MEMORY = OffsetMemory(4.0, 0.1)


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
        events: ``(m, 4)`` events near each marker: real ON and OFF, expected ON and OFF.
        recovery_s: Time in which pixels forget light that they lost without an event, s; 0: never.
    """

    course: Course
    states: NDArray[np.int64]
    discs: Discs
    on: NDArray[np.float64]
    off: NDArray[np.float64]
    pixel: PixelSteps
    residual: NDArray[np.float64]
    events: NDArray[np.float64]
    recovery_s: float = 0.0


def refine(
    events: BufferedEvents,
    start: Refined,
    still: NDArray[np.int64],
    cell: NDArray[np.int64],
    noise: NDArray[np.float64],
    rounds: int = MOST_ROUNDS,
) -> Refined:
    """Return everything refined.

    Args:
        events: The recording, markers brighter than the ground.
        start: Where to begin; its states are the samples to compare.
        still: ``(rests, 3)`` first, typical and last sample of each rest: nothing moves in it.
        cell: Nearest marker of each pixel, row by row.
        noise: ``(2,)`` ON and OFF events that are expected near a marker without any motion.
        rounds: Times that the ideal pixels walk at most.
    """
    at = start
    first_radius_px = start.discs.radius_px
    for _ in range(rounds):
        at = replace(at, course=_frozen(at.course, still))
        seen = walk(events, at.course, at.states, at.discs, at.pixel, at.recovery_s)
        found = corrections(seen, at.course.shown(at.states), at.discs, at.pixel, MEMORY)
        at = _stepped(at, found, first_radius_px)
        at = _recounted(at, seen, cell, noise)
        if _settled(found):
            break
    return replace(at, course=_frozen(at.course, still))


def _settled(found: Corrections) -> bool:
    # Medians: a marker that the recording hardly shows may never settle.
    changes = np.abs(found.move_px).mean(axis=(0, 2)), np.abs(found.common_px).max(axis=1)
    return max(float(np.median(change)) for change in changes) < SETTLED_PX


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


def moved_course(course: Course, states: NDArray[np.int64], found: Corrections) -> Course:
    """Return a course whose places are corrected, in between of the states as well.

    Args:
        course: Where the markers went.
        states: ``(k,)`` samples at which they were compared.
        found: What was found there.
    """
    change = PLACE_GAIN * found.move_px
    change += found.common_px[:, :2].clip(-LARGEST_MOVE_PX, LARGEST_MOVE_PX)
    length = np.linalg.norm(change, axis=2, keepdims=True)
    change *= np.minimum(1.0, LARGEST_MOVE_PX / np.maximum(length, 1e-9))
    return replace(
        course,
        center_px=course.center_px + _between(states, change, len(course.index)),
        stretch_px=_stretched(course, states, found.stretch_px),
    )


def _stretched(
    course: Course, states: NDArray[np.int64], grown_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    grown = _between(states, PLACE_GAIN * grown_px, len(course.index))
    return (course.stretches + grown).clip(-LARGEST_STRETCH_PX, LARGEST_STRETCH_PX)


def _between(
    states: NDArray[np.int64], change: NDArray[np.float64], samples: int
) -> NDArray[np.float64]:
    # Straight lines from state to state, for every marker and every column.
    flat = change.reshape(len(states), -1)
    at = np.arange(samples)
    between = np.column_stack([np.interp(at, states, column) for column in flat.T])
    return between.reshape(samples, *change.shape[1:])


def _stepped(at: Refined, found: Corrections, first_radius_px: NDArray[np.float64]) -> Refined:
    growth = found.common_px[:, 2:].clip(-LARGEST_GROWTH_PX, LARGEST_GROWTH_PX)
    radius_px, edge_px = (
        np.column_stack([at.discs.radius_px, at.discs.edge_px]) + SHAPE_GAIN * growth
    ).T
    low, high = (share * first_radius_px for share in RADIUS_SHARES)
    return replace(
        at,
        course=moved_course(at.course, at.states, found),
        discs=at.discs.with_shape(radius_px.clip(low, high), edge_px.clip(*EDGE_BOUNDS_PX)),
        residual=np.sqrt(found.squares / np.maximum(found.weights, 1e-9)),
    )


def _recounted(
    at: Refined, seen: Walk, cell: NDArray[np.int64], noise: NDArray[np.float64]
) -> Refined:
    # Fewer events than expected: each stands for more. Counts tell ON from OFF, swings the scale.
    real = (seen.events[:, :2] - noise).clip(0.0) + COUNT_PRIOR
    factor = (seen.events[:, 2:] + COUNT_PRIOR) / real
    counted = np.sqrt(factor.prod(axis=1))
    gain = swing_gain(seen, MEMORY, cell, 1.0 / counted).clip(LEAST_GAIN, 1.0 / LEAST_GAIN)
    factor = (factor / (counted * gain)[:, np.newaxis]) ** COUNT_GAIN
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


# Full swings by which counts of events are believed beforehand, for the sensor as a whole and for
# each marker beside the sensor. Slides show 1,000 a marker; the recorded sensor, whose edges are
# so wide that hardly a pixel swings fully, shows one a marker: such swings tell nothing.
SENSOR_PRIOR, MARKER_PRIOR = 300.0, 50.0


def swing_gain(
    seen: Walk, memory: OffsetMemory, cell: NDArray[np.int64], counted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return ``(m,)`` sums of real events' steps over those of ideal pixels, for full swings.

    Args:
        seen: Real and ideal pixels at the states.
        memory: Which states tell a pixel's offset.
        cell: Nearest marker of each pixel, row by row.
        counted: ``(m,)`` the same gain as the counts of events tell it: real over expected events.
    """
    product, square = _sums(seen, memory, cell, len(counted))
    usual = float(np.median(counted))
    known = square / (square + MARKER_PRIOR)
    sensor = (known @ product + SENSOR_PRIOR * usual) / (known @ square + SENSOR_PRIOR)
    beforehand = counted * (sensor / usual)
    return (product + MARKER_PRIOR * beforehand) / (square + MARKER_PRIOR)


def _sums(
    seen: Walk, memory: OffsetMemory, cell: NDArray[np.int64], markers: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Of each marker's full swings: real times ideal changes, and the squares of the ideal ones.
    states = len(seen.drawn)
    images = [image.reshape(states, -1) for image in (seen.drawn, seen.measured, seen.expected)]
    moving = np.flatnonzero((images[0] != images[0][0]).any(axis=0))

    def add_up(chosen: slice) -> NDArray[np.float64]:
        pixels = moving[chosen]
        drawn, *both = (image.take(pixels, axis=1) for image in images)
        real, ideal = memory.changes(np.array(both), drawn)
        weight = ideal / (1.0 + ((real - ideal) / RESIDUAL_LEVEL) ** 2)
        weight[(drawn > RIM_LEVELS[0]) & (drawn < RIM_LEVELS[1])] = 0.0
        sums = [(weight * change).sum(axis=0) for change in (real, ideal)]
        return np.array([np.bincount(cell[pixels], one, markers) for one in sums], float)

    product, square = np.sum(divide(len(moving), add_up), axis=0)
    return product, square
