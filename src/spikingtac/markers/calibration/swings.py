"""What one event of each marker and of each pixel stands for, from full swings of brightness.

Once it is known where the markers went, one can see which pixels a marker covered after they had
been ground, or left after it had covered them. With a and b the shares of a full swing that an ON
and an OFF event stand for, the mean counts of such swings are

    1 = a (n_on + 1/2) + b / 2,    1 = b (n_off + 1/2) + a / 2,

since the level at which the pixel fired last lies anywhere within a step before the swing begins.
What falls back on the way up, and rises on the way down, is taken off: a marker that turns round
over a pixel, or noise near a threshold, fires pairs of events that add up to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.disc_levels import Discs, draw_kernel
from spikingtac.markers.calibration.finding.level_maps import MeanSteps
from spikingtac.markers.calibration.following import Course, PixelSteps
from spikingtac.markers.graded.appearance import nearest_marker

GROUND_LEVEL, MARKER_LEVEL = 0.03, 0.95
"""A pixel is ground below the first level and marker above the second."""

SETTLE_SAMPLES = 3
"""Events that come so many samples late still count for a swing."""

NEIGHBOUR_SWINGS = 10.0
"""Swings at its neighbours' counts that each marker is given beforehand: light and lens change
slowly over the skin."""

PIXEL_SWINGS = 3.0
"""Swings at its marker's counts that each pixel is given beforehand."""

FEWEST_SWINGS = 50.0
"""Full swings in all below which the sensor's mean steps are kept."""

FEWEST_EVENTS = 0.3
"""Least mean count of a full swing: a rarer event tells nothing."""

STEP_BOUNDS = (0.02, 1.0)
"""Least and largest step."""


@dataclass(frozen=True, slots=True)
class LearnedSteps:
    """The steps of markers and pixels.

    Attributes:
        on: ``(m,)`` share of a full swing of each marker's ON event.
        off: ``(m,)`` the same for OFF events.
        pixel: The same for each pixel, in units of the swing of the marker that rests nearest.
        swings: ``(m,)`` full swings seen of each marker, both ways together.
        pixel_swings: ``(height, width)`` full swings seen of each pixel.
    """

    on: NDArray[np.float64]
    off: NDArray[np.float64]
    pixel: PixelSteps
    swings: NDArray[np.float64]
    pixel_swings: NDArray[np.float32]


def learn_steps(
    events: BufferedEvents,
    course: Course,
    discs: Discs,
    rest_px: NDArray[np.float64],
    start: MeanSteps,
) -> LearnedSteps:
    """Count the events of full swings and turn them into steps.

    Args:
        events: The recording, markers brighter than the ground.
        course: Where the markers went.
        discs: How they look.
        rest_px: ``(m, 2)`` where they rest, px.
        start: The sensor's mean steps, kept where too few swings were seen.
    """
    markers = len(rest_px)
    by_marker = np.zeros((markers, 6))
    by_pixel = np.zeros((events.pixels, 6), np.float32)
    count_swings_kernel(
        events.code,
        (course.index, course.center_px),
        (discs.shape, discs.tables),
        np.zeros(events.shape, np.float32),
        (by_marker, by_pixel),
    )
    on_per_off = np.divide(*_mean_counts(by_marker, start))
    for swings in by_marker, by_pixel:
        swings[:, 0] -= on_per_off * swings[:, 4]
        swings[:, 2] -= swings[:, 5] / on_per_off
    counts = _smooth_counts(by_marker, rest_px, start)
    on, off = steps_of_counts(counts[0], counts[1])
    cell = nearest_marker(rest_px, events.size).ravel()
    single = [
        (by_pixel[:, column] + PIXEL_SWINGS * counts[column // 2][cell])
        / (by_pixel[:, column + 1] + PIXEL_SWINGS)
        for column in (0, 2)
    ]
    pixel_on, pixel_off = (
        step.astype(np.float32).reshape(events.shape) for step in steps_of_counts(*single)
    )
    return LearnedSteps(
        on,
        off,
        PixelSteps(pixel_on, pixel_off),
        by_marker[:, 1] + by_marker[:, 3],
        (by_pixel[:, 1] + by_pixel[:, 3]).reshape(events.shape),
    )


def _smooth_counts(
    by_marker: NDArray[np.float64], rest_px: NDArray[np.float64], start: MeanSteps
) -> list[NDArray[np.float64]]:
    # Mean ON and OFF events of each marker's swings, a little drawn to its neighbours'.
    mean, near = _mean_counts(by_marker, start), _nearby_sums(by_marker, rest_px)
    counts = []
    for column in (0, 2):
        known, swings = by_marker[:, column], by_marker[:, column + 1]
        expected = (near[:, column] + mean[column // 2]) / (near[:, column + 1] + 1.0)
        counts.append((known + NEIGHBOUR_SWINGS * expected) / (swings + NEIGHBOUR_SWINGS))
    return counts


def steps_of_counts(
    on: NDArray[np.floating], off: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ON and OFF steps that mean counts of full swings stand for.

    Args:
        on: Mean ON events of a swing from ground to marker, any shape.
        off: Mean OFF events of the way back, same shape.

    Example:
        >>> on, off = steps_of_counts(np.array([6.0]), np.array([6.0]))
        >>> float(on.round(4)[0])  # 1 / (6 + 1)
        0.1429
    """
    rises = np.maximum(on, FEWEST_EVENTS) + 0.5
    falls = np.maximum(off, FEWEST_EVENTS) + 0.5
    both = rises * falls - 0.25
    on_step = ((falls - 0.5) / both).clip(*STEP_BOUNDS)
    return on_step, ((rises - 0.5) / both).clip(*STEP_BOUNDS)


def _mean_counts(by_marker: NDArray[np.float64], start: MeanSteps) -> tuple[float, float]:
    total = by_marker.sum(axis=0)
    if min(total[1], total[3]) < FEWEST_SWINGS:
        # The inverse of steps_of_counts.
        return (
            (1.0 - 0.5 * start.off) / start.on - 0.5,
            (1.0 - 0.5 * start.on) / start.off - 0.5,
        )
    return float(total[0] / total[1]), float(total[2] / total[3])


def _nearby_sums(
    by_marker: NDArray[np.float64], rest_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    # Sums over the neighbourhood, a Gaussian as wide as the pitch.
    apart = np.hypot(*(rest_px[:, np.newaxis] - rest_px[np.newaxis]).transpose(2, 0, 1))
    pitch = float(np.median(np.sort(apart, axis=1)[:, 1])) if len(rest_px) > 1 else 1.0
    return np.exp(-0.5 * (apart / pitch) ** 2) @ by_marker


@njit(cache=True)
def count_swings_kernel(
    code: NDArray[np.uint32],
    course: tuple[NDArray[np.int64], NDArray[np.float64]],
    discs: tuple[NDArray[np.float64], NDArray[np.float32]],
    drawn: NDArray[np.float32],
    out: tuple[NDArray[np.float64], NDArray[np.float32]],
) -> None:
    """Sum ON events and number of rises, OFF events and number of falls, and events against them.

    ``out`` is ``(m, 6)`` by marker and ``(pixels, 6)`` by pixel: the sums named above, OFF events
    of rises and ON events of falls. ``drawn`` is an empty image. Only
    pixels in which something happens are visited: those that a disc touches, and those that have
    not settled on the ground since.
    """
    index, places = course
    pixels = drawn.size
    flat, owner = drawn.ravel(), np.full(drawn.shape, -1, np.int32)
    whose = owner.ravel()
    touched = np.empty(pixels, np.int64)
    counts, visits = np.zeros((pixels, 2), np.int32), np.zeros((pixels, 4), np.int32)
    active, is_active, many = np.arange(pixels), np.ones(pixels, np.bool_), pixels
    counted_at = np.full(pixels, -1, np.int64)
    at = index[0]
    for sample in range(len(index)):
        for i in range(at, index[sample]):
            _renew_kernel(code[i] >> 1, sample, is_active, counted_at, counts)
            counts[code[i] >> 1, code[i] & 1] += 1
        at = index[sample]
        drawn_pixels = draw_kernel(places[sample], discs, (drawn, owner), touched)
        for i in range(drawn_pixels):
            q = touched[i]
            if not is_active[q]:
                _renew_kernel(q, sample, is_active, counted_at, counts)
                is_active[q] = True
                active[many] = q
                many += 1
        many = _visit_active_kernel(active[:many], is_active, (flat, whose), (counts, visits), out)
        for i in range(drawn_pixels):
            flat[touched[i]] = 0.0
            whose[touched[i]] = -1


@njit(cache=True)
def _renew_kernel(
    q: int,
    sample: int,
    is_active: NDArray[np.bool_],
    counted_at: NDArray[np.int64],
    counts: NDArray[np.int32],
) -> None:
    """Begin to count a pixel on the ground anew at each sample: such events are noise."""
    if not is_active[q] and counted_at[q] != sample:
        counts[q] = 0
        counted_at[q] = sample


@njit(cache=True)
def _visit_active_kernel(
    active: NDArray[np.int64],
    is_active: NDArray[np.bool_],
    image: tuple[NDArray[np.float32], NDArray[np.int32]],
    state: tuple[NDArray[np.int32], NDArray[np.int32]],
    out: tuple[NDArray[np.float64], NDArray[np.float32]],
) -> int:
    """Visit the active pixels, drop those that rest on the ground, and return how many are left."""
    flat, whose = image
    left = 0
    for i in range(len(active)):
        q = active[i]
        now = 2 if flat[q] > MARKER_LEVEL else 1 if flat[q] < GROUND_LEVEL else 0
        visit_kernel(q, now, whose[q], state, out)
        if now == 1 and state[1][q, 1] == 0:
            is_active[q] = False
        else:
            active[left] = q
            left += 1
    return left


@njit(cache=True)
def visit_kernel(
    q: int,
    now: int,
    owner: Any,
    state: tuple[NDArray[np.int32], NDArray[np.int32]],
    out: tuple[NDArray[np.float64], NDArray[np.float32]],
) -> None:
    """Note that pixel ``q`` is ground (1), marker (2) or in between (0); sum a swing that ended.

    ``state`` holds for each pixel its OFF and ON events since it was at one end, and the end that
    it was at last, the end of a swing that has just come to it, samples since then, its marker.
    """
    counts, visits = state
    by_marker, by_pixel = out
    last, ended, waited, marker = visits[q]
    if ended != 0:
        visits[q, 2] = waited + 1
        if waited + 1 >= SETTLE_SAMPLES or now != last:
            column = 0 if ended == 2 else 2
            way = 1 if ended == 2 else 0
            add_swing_kernel(by_marker[marker], column, counts[q, way], counts[q, 1 - way])
            add_swing_kernel(by_pixel[q], column, counts[q, way], counts[q, 1 - way])
            visits[q, 1] = 0
            counts[q] = 0
    if now == 0:
        return
    if now == 2:
        visits[q, 3] = owner
    if now != last and last != 0:
        visits[q, 1] = now
        visits[q, 2] = 0
    elif visits[q, 1] == 0:
        counts[q] = 0
    visits[q, 0] = now


@njit(cache=True)
def add_swing_kernel(sums: NDArray[np.floating], column: int, along: Any, against: Any) -> None:
    """Add one swing to its ``(6,)`` sums; column 0 for a rise, 2 for a fall."""
    sums[column] += along
    sums[column + 1] += 1
    sums[4 + column // 2] += against
