"""Two clocks from what both sensors saw: a tap, a grip, a slide stirs the events of both.

The events of each are counted by the millisecond. Where the two courses look alike as wholes, short
stretches are compared one by one; through their shifts goes the line of the time map.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import correlate

from spikingtac.errors import RecordingError
from spikingtac.events.clock import TimeMap, through_moments
from spikingtac.types import EventPacket

STEP_US = 1_000  # Step of the courses, us: the window of contact detection.

# Steps that are joined for the first look: a drift of 100 ppm moves a course by one of the joined
# ones in 200 s.
COARSE_STEPS = 20

# Changes slower than this, in steps, are taken out: creep and noise differ between sensors.
SLOW_STEPS = 500
STRETCH_STEPS = 2_000  # Length of a stretch that is compared, steps (ours: it holds a whole touch).

# How far a stretch is looked for from where the whole was found, steps: 100 ppm in 1,000 s.
NEAR_STEPS = 100

# Correlation from which on two courses show the same (ours; unrelated touches stay below 0.2).
LEAST_ALIKE = 0.4

# A second place that is alike to this share of the best one makes the best one a guess (ours).
CLEARLY = 0.9
LEAST_STIR = 0.1  # A stretch counts where it holds this share of the liveliest one's stir (ours).

# How finely a stretch of 1 ms steps tells its shift, us (measured on simulated fingers).
FLOOR_US = 100.0


@dataclass(frozen=True, slots=True)
class Course:
    """How much something stirs over time.

    Attributes:
        t_first_us: Time of the first step, us.
        stir: ``(n,)`` one value for each :data:`STEP_US`.
    """

    t_first_us: int
    stir: NDArray[np.float64]


def course_of(packets: Iterable[EventPacket]) -> Course:
    """Return the events of a stream by the millisecond; memory grows by 8 bytes for each."""
    first_us: int | None = None
    counts = np.zeros(1 << 16)
    steps = 0
    for packet in packets:
        if not len(packet):
            continue
        first_us = int(packet.t[0]) if first_us is None else first_us
        number = (packet.t - first_us) // STEP_US
        while number[-1] >= len(counts):
            counts = np.concatenate([counts, np.zeros(len(counts))])
        steps = int(number[-1]) + 1
        counts[:steps] += np.bincount(number, minlength=steps)
    if first_us is None:
        raise RecordingError("a recording without events shares no motion; check the camera")
    return Course(first_us, counts[:steps])


def through_motion(own: Course, base: Course) -> TimeMap:
    """Return the map from one clock to the other, from the courses of two sensors.

    Raises:
        RecordingError: The courses do not look alike, or alike at several places.
    """
    mine, theirs = _quick(own.stir), _quick(base.stir)
    shift = _coarse_shift(mine, theirs)
    places, shifts = [], []
    for first, stretch in _lively(mine):
        found = _fine_shift(stretch, theirs, first + shift)
        if found is not None:
            places.append(first + len(stretch) / 2)
            shifts.append(found - first)
    if not places:
        raise RecordingError(
            "no touch looks alike for both sensors; tap something that both feel, a few times"
        )
    own_us = own.t_first_us + np.array(places) * STEP_US
    base_us = base.t_first_us + (np.array(places) + np.array(shifts)) * STEP_US
    return through_moments(own_us, base_us, "motion", FLOOR_US)


def _quick(stir: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quick changes, with the strong ones dampened: sensors differ in their sensitivity."""
    course = np.log1p(stir)
    return course - uniform_filter1d(course, SLOW_STEPS, mode="nearest")


def _coarse_shift(mine: NDArray[np.float64], theirs: NDArray[np.float64]) -> int:
    """Return by how many steps the one course is later in the other, as wholes."""
    low = [_joined(np.abs(course)) for course in (mine, theirs)]
    low = [course - course.mean() for course in low]
    scale = float(np.sqrt((low[0] ** 2).sum() * (low[1] ** 2).sum()))
    score = correlate(low[1], low[0]) / (scale if scale > 0.0 else 1.0)
    best = int(score.argmax())
    if score[best] < LEAST_ALIKE:
        raise RecordingError(
            f"the two sensors' events agree by {score[best]:.2f} at best, {LEAST_ALIKE} is needed; "
            "are they of the same time? tap something that both feel, at odd moments"
        )
    others = score.copy()
    others[max(best - NEAR_STEPS // COARSE_STEPS, 0) : best + NEAR_STEPS // COARSE_STEPS + 1] = 0.0
    if others.max() > CLEARLY * score[best]:
        raise RecordingError(
            "the two sensors' events agree at several places, as touches that repeat alike do; "
            "tap something that both feel, at odd moments"
        )
    return (best - (len(low[0]) - 1)) * COARSE_STEPS


def _joined(course: NDArray[np.float64]) -> NDArray[np.float64]:
    whole = len(course) // COARSE_STEPS * COARSE_STEPS
    if not whole:
        raise RecordingError(f"the recording lasts {len(course)} ms, too short to compare")
    return course[:whole].reshape(-1, COARSE_STEPS).mean(axis=1)


def _lively(course: NDArray[np.float64]) -> list[tuple[int, NDArray[np.float64]]]:
    """Return the stretches in which something happens, each with its first step."""
    length = min(STRETCH_STEPS, len(course))
    firsts = range(0, len(course) - length + 1, length)
    parts = [(first, course[first : first + length]) for first in firsts]
    stir = [float((part**2).sum()) for _, part in parts]
    return [part for part, much in zip(parts, stir, strict=True) if much > LEAST_STIR * max(stir)]


def _fine_shift(
    stretch: NDArray[np.float64], theirs: NDArray[np.float64], place: int
) -> float | None:
    """Return where a stretch is found near a place of the other course, in steps, or None."""
    first = max(place - NEAR_STEPS, 0)
    around = theirs[first : place + len(stretch) + NEAR_STEPS]
    lags = len(around) - len(stretch) + 1
    if lags < 3:
        return None
    mine = stretch - stretch.mean()
    windows = np.lib.stride_tricks.sliding_window_view(around, len(stretch))
    spread = windows.std(axis=1) * len(stretch) * mine.std()
    score = windows @ mine / np.where(spread > 0.0, spread, np.inf)
    best = int(score.argmax())
    if score[best] < LEAST_ALIKE or not 0 < best < lags - 1:
        return None
    left, top, right = score[best - 1 : best + 2]
    bend = left - 2.0 * top + right
    return first + best + float(0.5 * (left - right) / bend if bend < 0.0 else 0.0)
