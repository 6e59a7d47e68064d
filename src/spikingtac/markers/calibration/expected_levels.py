"""What ideal pixels would have fired while the markers went their way.

Every pixel follows the logarithm of a blurred disc and fires when it has left the level of its last
event by a step. Where that level stood when the recording began is not known, so that several ideal
pixels, spread evenly over the possible levels, are followed for each real one. What real pixels
fired is compared with their mean: unlike a fit to the levels themselves this is not misled by
partial swings that give no event, and by steps that are large in one direction. On sensors that
recover (:mod:`.recovery`), ideal pixels forget what light they lost without an event.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.disc_levels import (
    Course,
    Discs,
    PixelSteps,
    draw_kernel,
    stretched_kernel,
)
from spikingtac.markers.calibration.recording import BufferedEvents
from spikingtac.state_map.two_threads import divide

# Ideal pixels for each real one: their mean is within an eighth of a step of the true mean.
PHASES = 4

STILL_LEVEL = 1e-4  # Smaller changes of the level are no motion.


@dataclass(frozen=True, slots=True)
class Walk:
    """Real and ideal pixels at chosen samples.

    Attributes:
        measured: ``(states, height, width)`` sum of the real events' steps since the start.
        expected: The mean sum of the ideal events' steps since the start.
        drawn: The level that the discs show.
        events: ``(m, 4)`` events near each marker: real ON and OFF, expected ON and OFF.
    """

    measured: NDArray[np.float32]
    expected: NDArray[np.float32]
    drawn: NDArray[np.float32]
    events: NDArray[np.float64]


def walk(
    events: BufferedEvents,
    course: Course,
    states: NDArray[np.int64],
    discs: Discs,
    steps: PixelSteps,
    recovery_s: float = 0.0,
) -> Walk:
    """Let ideal pixels fire along a course.

    Args:
        events: The recording, markers brighter than the ground.
        course: Where the markers went.
        states: Which samples to keep, increasing, no sample twice.
        discs: How the markers look.
        steps: What one event of each pixel stands for.
        recovery_s: Time in which pixels forget light that they lost without an event, s; 0: never.
    """
    shape = (len(states), *events.shape)
    measured, expected, drawn = kept = np.zeros((3, *shape), np.float32)
    by_pixel = kept.reshape(3, len(states), shape[1] * shape[2])
    looks = discs.shape, discs.tables
    at_s = 1e-6 * events.times_at(course.index).astype(np.float64)
    recovery = at_s, (1.0 / recovery_s if recovery_s > 0.0 else 0.0)

    def walk_rows(rows: slice) -> NDArray[np.float64]:
        near = np.zeros((len(discs.radius_px), 4))
        pixels = slice(rows.start * events.size[0], rows.stop * events.size[0])
        walk_kernel(
            (events.code, pixels.start, events.size[0]),
            (course.index, course.center_px - [0.0, rows.start], course.stretches, states),
            looks,
            (steps.on[rows].ravel(), steps.off[rows].ravel()),
            recovery,
            (by_pixel[:, :, pixels], near),
        )
        near[:, 2:] /= PHASES
        return near

    counts = np.sum(divide(events.size[1], walk_rows), axis=0)
    return Walk(measured, expected, drawn, counts)


@njit(cache=True)
def follow_levels_kernel(
    which: tuple[NDArray[np.int64], NDArray[np.int32]],
    levels: tuple[NDArray[np.float32], NDArray[np.float32]],
    copies: tuple[NDArray[np.float32], NDArray[np.float32]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    events: NDArray[np.float64],
    clock: tuple[NDArray[np.float64], Any, Any],
) -> None:
    """Let pixels' ideal copies follow their levels; add what they fire to the markers' events.

    ``which`` is some pixels, and every pixel's marker; ``levels`` are those of now and of before;
    ``copies`` is ``(pixels, PHASES)``, the level at which each copy fired last, and ``(pixels,)``
    the mean sum of their steps. ``clock`` is when each pixel was followed last, the time of now, s,
    and the rate at which light that was lost without an event is forgotten, 1/s. (A call for each
    pixel counted references to all these arrays anew, and took twice the time.)
    """
    (chosen, marker), (now, before), (phases, sums) = which, levels, copies
    (on_steps, off_steps), (seen_s, now_s, per_s) = steps, clock
    for q in chosen:
        level = now[q]
        if abs(level - before[q]) <= STILL_LEVEL:
            continue
        on, off, share = on_steps[q], off_steps[q], np.float32(1.0)
        middle = np.float32(0.5) * (level + before[q])
        if per_s > 0.0:
            share = np.float32(np.exp(-per_s * (now_s - seen_s[q])))
        rises = falls = 0
        for phase in range(PHASES):
            last = phases[q, phase]
            if last > middle and share < np.float32(1.0):
                last = middle + share * (last - middle)
            while level > last + on:
                last += on
                rises += 1
            while level < last - off:
                last -= off
                falls += 1
            phases[q, phase] = last
        if rises or falls:
            events[marker[q], 2] += rises
            events[marker[q], 3] += falls
            sums[q] += (np.float32(rises) * on - np.float32(falls) * off) / np.float32(PHASES)
        before[q], seen_s[q] = level, now_s


@njit(cache=True)
def spread_kernel(
    phases: NDArray[np.float32],
    level: NDArray[np.float32],
    before: NDArray[np.float32],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> None:
    """Spread every pixel's copies evenly over the levels at which it may have fired last.

    ``before`` is filled with the levels.
    """
    on, off = steps
    count = phases.shape[1]
    for q in range(len(level)):
        before[q] = level[q]
        for phase in range(count):
            share = (phase + 0.5) / count
            phases[q, phase] = level[q] + off[q] - (on[q] + off[q]) * share


@njit(cache=True)
def sum_events_kernel(
    code: NDArray[np.uint32],
    first: int,
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    total: NDArray[np.float32],
    owner: NDArray[np.int32],
    events: NDArray[np.float64],
) -> None:
    """Add real events to their pixels' sums, and to the counts of the discs that cover them.

    The pixels are those of some rows; ``first`` is the number of the first of them in ``code``.
    """
    on, off = steps
    for i in range(len(code)):
        q = np.int64(code[i] >> 1) - first
        if q < 0 or q >= len(total):
            continue
        total[q] += on[q] if code[i] & 1 else -off[q]
        if owner[q] >= 0:
            events[owner[q], 0 if code[i] & 1 else 1] += 1


@njit(cache=True, nogil=True)
def walk_kernel(
    real: tuple[NDArray[np.uint32], int, int],
    course: tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]],
    discs: tuple[NDArray[np.float64], NDArray[np.float32]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    recovery: tuple[NDArray[np.float64], float],
    out: tuple[NDArray[np.float32], NDArray[np.float64]],
) -> None:
    """Walk along the samples; fill some rows of a :class:`Walk`.

    ``real`` is the codes of all events, the number of the first pixel of these rows, and their
    width; ``recovery`` is the time of each sample, s, and the rate at which pixels recover, 1/s;
    ``out`` is the measured, expected and drawn levels, ``(3, states, pixels)``, and the events.
    """
    (code, first, width), (at_s, per_s), (levels, events) = real, recovery, out
    shape = (levels.shape[2] // width, width)
    index, places, stretches, states = course
    image, owner = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
    now, whose = image.ravel(), owner.ravel()
    before, total = np.zeros(len(now), np.float32), np.zeros(len(now), np.float32)
    copies = np.empty((len(now), PHASES), np.float32), np.zeros(len(now), np.float32)
    touched, former = np.empty(len(now), np.int64), np.empty(len(now), np.int64)
    seen_s, last_owner = np.full(len(now), at_s[0]), np.full(len(now), -1, np.int32)
    at, formers, kept = index[0], 0, 0
    for sample in range(len(index)):
        sum_events_kernel(code[at : index[sample]], first, steps, total, last_owner, events)
        at, clock = index[sample], (seen_s, at_s[sample], per_s)
        stretched = (stretched_kernel(discs[0], stretches[sample]), discs[1])
        count = draw_kernel(places[sample], stretched, (image, owner), touched)
        if sample == 0:
            spread_kernel(copies[0], now, before, steps)
        for q in touched[:count]:
            last_owner[q] = whose[q]
        for some in (former[:formers], touched[:count]):  # what may be ground now, then the discs
            follow_levels_kernel((some, last_owner), (now, before), copies, steps, events, clock)
        if kept < len(states) and states[kept] == sample:
            for q in range(len(now)):
                levels[0, kept, q], levels[1, kept, q] = total[q], copies[1][q]
                levels[2, kept, q] = now[q]
            kept += 1
        former, touched, formers = touched, former, count
        for q in former[:count]:
            now[q], whose[q] = 0.0, -1
