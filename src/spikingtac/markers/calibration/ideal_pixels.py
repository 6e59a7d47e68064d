"""Simulation of ideal event pixels along the markers' paths, and comparison with the real pixels.

An ideal pixel follows the logarithm of a blurred disc, and fires when its level differs from the
level of its last event by a step. The initial level of the last event is unknown, so several
ideal pixels, spread evenly over the possible levels, are simulated for each real one. The levels of
the real events are compared with the mean of the ideal ones: unlike a fit to the image, this is
unbiased by partial swings without an event, and by steps that are large in one direction. Events of
full swings of the real pixels, from ground to marker or back, are counted.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import Discs, draw_kernel
from spikingtac.markers.calibration.find_markers import Evidence
from spikingtac.markers.calibration.recording import coded, times_at
from spikingtac.state_map.graded import Array
from spikingtac.types import FloatArray

PHASES = 4  # Ideal pixels per real one: their mean is exact to an eighth of a step.
STILL_LEVEL = 1e-4  # Smaller changes of the level are no motion.

# A pixel is ground below the first level and marker above the second; it swings between them.
GROUND_LEVEL, MARKER_LEVEL = 0.03, 0.95

SETTLE_SAMPLES = 3  # Samples after the end of a swing in which events still count for it.
# Shortest swing that is counted, s: a snap saturates the readout. (Without swings below 10 ms a
# simulated drag that ends in a snap is calibrated 0.13 px off, below 20 or 30 ms 0.09 px.)
SNAP_S = 0.02


@dataclass(frozen=True, slots=True)
class Model:
    """Generative model of the events: paths and shapes of the discs, and steps of the pixels.

    Attributes:
        center_px: ``(n, m, 2)`` position of each marker at each sample, px.
        stretch_px: ``(n, m, 3)`` stretch of each disc there, as defined by ``draw_kernel``, px.
        discs: Appearance of the markers.
        on: ``(m,)`` step of each marker's ON events, a share of a full swing.
        off: The same for OFF events.
        pixel: ``(2, pixels)`` steps of a pixel's ON and OFF events relative to its marker's.
        residual: ``(m,)`` rms residual of the levels around each marker.
        recovery_s: Time constant with which pixels adapt to a darkening, s; 0: they do not.
    """

    center_px: FloatArray
    stretch_px: FloatArray
    discs: Discs
    on: FloatArray
    off: FloatArray
    pixel: FloatArray
    residual: FloatArray
    recovery_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """Levels of real and ideal pixels at the states, and counts of events.

    Attributes:
        pixel: ``(p,)`` the pixels that a disc covers at any state.
        measured: ``(states, p)`` sum of the real events' steps since the start.
        expected: The mean sum of the ideal events' steps since the start.
        drawn: The level of the model's image.
        owner: The disc that covers each pixel, -1 for none.
        events: ``(m, 5)`` events near each marker: real ON and OFF, expected ON and OFF; last the
            sum of the times for which its pixels were looked at, s.
        swings: ``(pixels, 6)`` real events of the full swings of every pixel: ON events and sum of
            the heights of rises, OFF events and heights of falls, OFF events of rises, ON events of
            falls.
        marker_swings: ``(m, 6)`` the same sums for the marker that covered the pixel.
    """

    pixel: NDArray[np.int64]
    measured: NDArray[np.float32]
    expected: NDArray[np.float32]
    drawn: NDArray[np.float32]
    owner: NDArray[np.int32]
    events: FloatArray
    swings: FloatArray
    marker_swings: FloatArray


def compare(evidence: Evidence, model: Model) -> Comparison:
    """Simulate ideal pixels along a model's paths, and compare them with the real ones."""
    events, states = evidence.events, evidence.states
    steps = (np.array([model.on, model.off])[:, evidence.cell] * model.pixel).astype(np.float32)
    kept = np.zeros((3, len(states), events.pixels), np.float32)
    owner = np.zeros((len(states), events.pixels), np.int32)
    swings, near = np.zeros((events.pixels, 6)), np.zeros((len(model.on), 5))
    ended = np.zeros((len(model.on), 6))
    at_s = 1e-6 * (times_at(events, evidence.index) - events.t_start_us)
    compare_kernel(
        (coded(events), events.shape, at_s),
        (evidence.index, model.center_px, model.stretch_px, states),
        model.discs.looks,
        (steps[0], steps[1], 1.0 / model.recovery_s if model.recovery_s > 0.0 else 0.0),
        (kept, owner, near, (swings, ended)),
    )
    near[:, 2:4] /= PHASES
    pixel = np.flatnonzero((owner >= 0).any(axis=0))
    (measured, expected, drawn), owner = kept.take(pixel, axis=2), owner.take(pixel, axis=1)
    return Comparison(pixel, measured, expected, drawn, owner, near, swings, ended)


@njit(cache=True)
def follow_levels_kernel(
    which: tuple[Array, Array],
    levels: tuple[Array, Array],
    copies: tuple[Array, Array],
    steps: tuple[Array, Array],
    events: Array,
    clock: tuple[Array, Any, Any],
) -> None:
    """Advance the ideal pixels to their present levels, and count their events by marker.

    ``which`` holds the chosen pixels, and every pixel's marker; ``levels`` the present and the last
    levels; ``copies`` ``(pixels, PHASES)`` the level at which each ideal pixel fired last, and
    ``(pixels,)`` the mean sum of their steps; ``clock`` the time of each pixel's last update, the
    present time, s, and the rate of adaptation to a darkening, 1/s.
    """
    (chosen, marker), (now, before), (phases, sums) = which, levels, copies
    (on_steps, off_steps), (seen_s, now_s, per_s) = steps, clock
    since_s, kept = 0.0, np.float32(1.0)
    for q in chosen:
        level = now[q]
        if abs(level - before[q]) <= STILL_LEVEL:
            continue
        on, off, middle = on_steps[q], off_steps[q], np.float32(0.5) * (level + before[q])
        if per_s > 0.0 and now_s - seen_s[q] != since_s:  # most pixels share their last update
            since_s = now_s - seen_s[q]
            kept = np.float32(np.exp(-per_s * since_s))
        rises = falls = 0
        for phase in range(PHASES):
            last = phases[q, phase]
            if last > middle and kept < np.float32(1.0):
                last = middle + kept * (last - middle)
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
def count_events_kernel(code: Array, counts: Array, owner: Array, events: Array) -> None:
    """Count real events per pixel, OFF and ON, and per covering disc, ON and OFF."""
    for i in range(len(code)):
        q, on = code[i] >> 1, code[i] & 1
        counts[q, on] += 1
        if owner[q] >= 0:
            events[owner[q], 1 - on] += 1


@njit(cache=True)
def own_pixels_kernel(
    covered: Array, whose: Array, last_owner: Array, owned: Array, looked_s: Array, span_s: Array
) -> None:
    """Give pixels to the discs that cover them, and sum up how long each disc's are looked at, s.

    ``whose`` and ``last_owner`` hold each pixel's disc now, and its last one, which changes;
    ``owned`` the number of pixels of each disc, and last of none; ``span_s`` the times of this
    sample and of the next.
    """
    for q in covered:
        owned[last_owner[q]] -= 1.0
        owned[whose[q]] += 1.0
        last_owner[q] = whose[q]
    looked_s += owned[:-1] * (span_s[-1] - span_s[0])


@njit(cache=True)
def end_swings_kernel(
    chosen: NDArray[np.int64],
    image: tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32], bool],
    state: tuple[NDArray[np.int8], NDArray[np.int32], FloatArray, NDArray[np.float32]],
    counts: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]],
    out: tuple[FloatArray, FloatArray],
    now_s: float,
) -> None:
    """Add completed full swings to the sums of pixels and markers.

    ``image`` holds each pixel's level, its disc now and its last one, and whether only pixels that
    discs have left are meant; ``state`` each pixel's last end (1 ground, 2 marker, 0 none yet,
    negative at the start), the samples since a swing reached it (-1: none did), the time there, s,
    and how deep it went into each end, as a share of a full swing from the other one; ``counts``
    ``(pixels, 2)`` OFF and ON events now, at the last sample at an end, and at the swing's start.
    A pixel's first swing does not count: the level of its last event before it is not known.
    """
    (now, whose, marker, left), (end, since, end_s, deepest) = image, state
    (count, last, begun), (by_pixel, by_marker) = counts, out
    for q in chosen:
        if left and whose[q] >= 0:
            continue
        at = 2 if now[q] > MARKER_LEVEL else 1 if now[q] < GROUND_LEVEL else 0
        inside = now[q] if at == 2 else np.float32(1.0) - now[q]
        deepest[q, at] = max(inside, deepest[q, at]) if at == end[q] else inside
        if since[q] >= 0:
            since[q] += 1
            if at != end[q] or since[q] >= SETTLE_SAMPLES or left:
                column, along = (0, 1) if end[q] == 2 else (2, 0)
                until = last if at != end[q] else count
                for sums in (by_pixel[q], by_marker[marker[q]]):
                    sums[column] += until[q, along] - begun[q, along]
                    sums[column + 1] += deepest[q, 1] + deepest[q, 2] - 1.0
                    sums[4 + column // 2] += until[q, 1 - along] - begun[q, 1 - along]
                since[q] = -1
        if at != 0 and at != -end[q]:
            if at != end[q] and end[q] > 0 and now_s - end_s[q] > SNAP_S:
                since[q] = 0
                begun[q, 0], begun[q, 1] = last[q, 0], last[q, 1]
            end[q], end_s[q] = at, now_s
            last[q, 0], last[q, 1] = count[q, 0], count[q, 1]


@njit(cache=True)
def compare_kernel(
    real: tuple[Array, tuple[int, int], Array],
    paths: tuple[NDArray[np.int64], FloatArray, FloatArray, NDArray[np.int64]],
    looks: tuple[FloatArray, FloatArray, NDArray[np.float32]],
    steps: tuple[Array, Array, float],
    out: tuple[Any, ...],
) -> None:
    """Step through the samples; fill a :class:`Comparison`.

    ``real`` holds the codes of all events, the shape of an image, and the time of each sample, s;
    ``steps`` those of ON and OFF events of each pixel, and the rate of recovery, 1/s; ``out`` the
    levels ``(3, states, pixels)``, the owners, the events ``(m, 5)``, swings by pixel, by marker.
    """
    (code, shape, at_s), (levels, owners, near, swings) = real, out
    (index, center_px, stretch_px, states), (on, off, per_s) = paths, steps
    image, owner = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
    now, whose, count = image.ravel(), owner.ravel(), image.size
    before, phases = np.zeros(count, np.float32), np.empty((count, PHASES), np.float32)
    touched, former = np.empty(count, np.int64), np.empty(count, np.int64)
    seen_s, last_owner = np.full(count, at_s[0]), np.full(count, -1, np.int32)
    copies, counts = (phases, np.zeros(count, np.float32)), np.zeros((count, 2), np.int32)
    deepest = np.zeros((count, 3), np.float32)
    ends = np.zeros(count, np.int8), np.full(count, -1, np.int32), seen_s.copy(), deepest
    counted = counts, np.zeros_like(counts), np.zeros_like(counts)
    at, formers, kept, owned = index[0], 0, 0, np.zeros(len(near) + 1)
    for sample in range(len(index)):
        count_events_kernel(code[at : index[sample]], counts, last_owner, near)
        at, clock = index[sample], (seen_s, at_s[sample], per_s)
        place = center_px[sample], stretch_px[sample]
        covered = touched[: draw_kernel(place, looks, (image, owner), touched)]
        if sample == 0:  # spread the levels of the last events over one step
            before[:], ends[0][:] = now, -2 * (now > MARKER_LEVEL) - (now < GROUND_LEVEL)
            for phase in range(PHASES):
                phases[:, phase] = now + off - (on + off) * np.float32((phase + 0.5) / PHASES)
        own_pixels_kernel(covered, whose, last_owner, owned, near[:, 4], at_s[sample : sample + 2])
        for some, left in ((former[:formers], True), (covered, False)):
            follow_levels_kernel((some, last_owner), (now, before), copies, (on, off), near, clock)
            shown = now, whose, last_owner, left
            end_swings_kernel(some, shown, ends, counted, swings, clock[1])
        if kept < len(states) and states[kept] == sample:
            levels[0, kept] = on * counts[:, 1] - off * counts[:, 0]
            levels[1, kept], levels[2, kept], owners[kept] = copies[1], now, whose
            kept += 1
        former, touched, formers = touched, former, len(covered)
        for q in former[:formers]:
            now[q], whose[q] = 0.0, -1
