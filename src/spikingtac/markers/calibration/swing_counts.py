"""Count the events of full swings.

A pixel swings when a marker covers it after it was ground, or leaves it after it was covered.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.disc_levels import Course, Discs, draw_kernel
from spikingtac.markers.calibration.recording import BufferedEvents
from spikingtac.state_map.two_threads import divide

# A pixel is ground below the first level and marker above the second.
GROUND_LEVEL, MARKER_LEVEL = 0.03, 0.95

SETTLE_SAMPLES = 3  # Events that come so many samples late still count for a swing.


def count_swings(
    events: BufferedEvents, course: Course, discs: Discs
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return sums over the full swings of each marker ``(m, 6)`` and of each pixel ``(pixels, 6)``.

    The columns are ON events and number of rises, OFF events and number of falls, and events
    against them: OFF events of rises and ON events of falls.

    Args:
        events: The recording, markers brighter than the ground.
        course: Where the markers went.
        discs: How they look.
    """
    by_pixel = np.zeros((*events.shape, 6), np.float32)
    looks = discs.shape, discs.tables

    def count_rows(rows: slice) -> NDArray[np.float64]:
        sums = np.zeros((len(discs.radius_px), 6))
        count_swings_kernel(
            (events.code, rows.start * events.size[0]),
            (course.index, course.center_px - [0.0, rows.start]),
            looks,
            np.zeros((rows.stop - rows.start, events.size[0]), np.float32),
            (sums, by_pixel[rows].reshape(-1, 6)),
        )
        return sums

    by_marker = np.sum(divide(events.size[1], count_rows), axis=0)
    return by_marker, by_pixel.reshape(-1, 6)


@njit(cache=True, nogil=True)
def count_swings_kernel(
    events: tuple[NDArray[np.uint32], int],
    course: tuple[NDArray[np.int64], NDArray[np.float64]],
    discs: tuple[NDArray[np.float64], NDArray[np.float32]],
    drawn: NDArray[np.float32],
    out: tuple[NDArray[np.float64], NDArray[np.float32]],
) -> None:
    """Sum ON events and number of rises, OFF events and number of falls, and events against them.

    ``out`` is ``(m, 6)`` by marker and ``(pixels, 6)`` by pixel: the sums named above, OFF events
    of rises and ON events of falls. ``drawn`` is an empty image of some rows, and ``events`` holds
    all codes and the number of the first pixel of these rows. Only pixels in which something
    happens are visited: those that a disc touches, and those that have not settled on the ground
    since.
    """
    (code, first), (index, places) = events, course
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
            q = np.int64(code[i] >> 1) - first
            if q >= 0 and q < pixels:
                _renew_kernel(q, sample, is_active, counted_at, counts)
                counts[q, code[i] & 1] += 1
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
    q: Any,
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
    """Visit the active pixels, drop those that rest on the ground, and return how many are left.

    Each is ground (1), marker (2) or in between (0); a swing that ended is summed. ``state`` holds
    for each pixel its OFF and ON events since it was at one end, and the end that it was at last,
    the end of a swing that has just come to it, samples since then, its marker. (A call for each
    pixel would count references to these arrays anew, and takes five times the time.)
    """
    (flat, whose), (counts, visits) = image, state
    left = 0
    for i in range(len(active)):
        q = active[i]
        now = 2 if flat[q] > MARKER_LEVEL else 1 if flat[q] < GROUND_LEVEL else 0
        last = visits[q, 0]
        if visits[q, 1] != 0:
            visits[q, 2] += 1
            if visits[q, 2] >= SETTLE_SAMPLES or now != last:
                _end_swing_kernel(q, state, out)
        if now != 0:
            if now == 2:
                visits[q, 3] = whose[q]
            if now != last and last != 0:
                visits[q, 1], visits[q, 2] = now, 0
            elif visits[q, 1] == 0:
                counts[q, 0] = counts[q, 1] = 0
            visits[q, 0] = now
        is_active[q] = now != 1 or visits[q, 1] != 0
        if is_active[q]:
            active[left] = q
            left += 1
    return left


@njit(cache=True)
def _end_swing_kernel(
    q: int,
    state: tuple[NDArray[np.int32], NDArray[np.int32]],
    out: tuple[NDArray[np.float64], NDArray[np.float32]],
) -> None:
    """Sum a pixel's swing, and begin to count anew."""
    (counts, visits), (by_marker, by_pixel) = state, out
    rose = visits[q, 1] == 2
    column, along, against = 0 if rose else 2, counts[q, int(rose)], counts[q, 1 - int(rose)]
    add_swing_kernel(by_marker[visits[q, 3]], column, along, against)
    add_swing_kernel(by_pixel[q], column, along, against)
    visits[q, 1] = counts[q, 0] = counts[q, 1] = 0


@njit(cache=True)
def add_swing_kernel(sums: NDArray[np.floating], column: int, along: Any, against: Any) -> None:
    """Add one swing to its ``(6,)`` sums; column 0 for a rise, 2 for a fall."""
    sums[column] += along
    sums[column + 1] += 1
    sums[4 + column // 2] += against
