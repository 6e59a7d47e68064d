"""How the tracker should read the events: by which steps, and by which fit.

Its steps may be larger or smaller than those that explain the events.

The tracker sees each event once and has no second look: a disc that lags behind its marker lets the
map leak towards the wrong place. Where OFF events are rare, or where edges are so wide that no
pixel swings fully, steps that explain the counts of events on the average let it lag. How far, the
recording itself tells: all events together say where the markers went
(:mod:`spikingtac.markers.calibration.refine`), and ON and OFF steps are scaled while that
brings the tracker nearer to it. On sensors like the twin's the steps stay as they are, on the
recorded one ON steps grow 2.4 times and OFF steps shrink by a third.

Where OFF events are rare, and the tracker asks for the same ratio of the steps as the counts of
events, bands are fitted instead (:mod:`spikingtac.markers.graded.band_fit`), with the steps that
explain the events. Where the two ratios differ, bands, which have no anchor but the steps, stray;
but not on sensors that recover, such as the recorded one: there every rest is an anchor
(:mod:`spikingtac.markers.graded.band_locator`). Ours.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.calibration.recording import BufferedEvents
from spikingtac.markers.calibration.reference import CREPT_SHARE, typical
from spikingtac.markers.calibration.refine import Refined
from spikingtac.markers.graded.tracker import GradedTracker, GradedTrackerConfig
from spikingtac.types import EventPacket

GROWTH = 1.25
"""Factor by which steps grow or shrink at a time."""

MOST_POWER = 8
"""Times that they grow or shrink at most: six-fold."""

LEAST_GAIN = 0.02
"""Share by which the distance must shrink in a move: less is chance."""

TRUSTED_PX = 0.25
"""Nearer than this the steps are kept: the course itself is not known better. (On slides of the
twin, at 0.13 px, other steps come 5 % nearer, and err by 27 % more elsewhere.)"""

Powers = tuple[int, int]
"""How often ON and OFF steps are multiplied by :data:`GROWTH`."""

ALIKE: tuple[Powers, ...] = ((1, 1), (-1, -1))
APART: tuple[Powers, ...] = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, -1), (-1, 1))
"""Moves that keep the ratio of the steps, and those that change it."""

GAIN_APART = 0.2
"""Share by which the distance must shrink for another ratio: counts of events tell it well. (Not
where pixels recover: the graded map, which ``fast`` reads, does not.)"""

RARE_OFF_RATIO = 1.3
"""An OFF step over an ON step from which bands are fitted (ours: on six simulated sensors with
ratios of 1.1 to 4.2 they err by 20 to 52 % less than the graded map, on v2e's, of 1, by more)."""

PERIODS_US = 4_000, 64_000
"""Time between estimates in motion and while nothing moves: at 100 px/s a marker moves by 0.4 px in
the former. (Every 4 ms always: five times the time, the same factors, and places that differ by
0.05 px on the average, two recordings.)"""

BAND_PERIODS_US = 1_000, 4_000
"""The same for bands, whose prediction strays over longer times. (1 ms at rest, too: twice the
time; the rests of the recorded sensor differ by 0.03 px.)"""

EVENTS_PER_MARKER = 1.0
"""A stretch with fewer events than this a marker is no motion: a pixel of it sends some 30."""


def with_step_scale(
    events: BufferedEvents, refined: Refined, calibration: Calibration
) -> tuple[Calibration, bool]:
    """Return a calibration with the steps, and the way to fit discs, that suit the sensor.

    Also whether the tracker's own rests should be the reference: it asks for another ratio of the
    steps than the events, or pixels recover.

    Args:
        events: The recording, markers brighter than the ground.
        refined: Where all events together say that the markers went.
        calibration: What was learned from them.
    """
    states, course = refined.states, refined.course
    on, off = fit_step_scale(events, calibration, (course.index[states], course.center_px[states]))
    scaled = calibration.with_steps_scaled(on, off)
    if calibration.recovery_s is not None or (on == off and has_rare_off(calibration)):
        scaled = replace(scaled, band_scale_on=1.0 / on, band_scale_off=1.0 / off)
    noted = replace(scaled, provenance={**scaled.provenance, "step_scale": [on, off]})
    return noted, on != off or calibration.recovery_s is not None


def has_rare_off(calibration: Calibration) -> bool:
    """Return whether an OFF event stands for so much more than an ON event that bands serve."""
    on, off = calibration.step_on, calibration.step_off
    return on is not None and off is not None and off > RARE_OFF_RATIO * on


def fit_step_scale(
    events: BufferedEvents,
    calibration: Calibration,
    places: tuple[NDArray[np.int64], NDArray[np.float64]],
) -> tuple[float, float]:
    """Return the factors of ON and OFF steps with which the tracker goes where the markers went.

    Args:
        events: The recording, markers brighter than the ground.
        calibration: As all events together explain it.
        places: ``(k,)`` how many events came before each known place, and the places ``(k, m, 2)``,
            px.
    """
    index, known_px = places
    at_us = events.times_at(index)
    measured = calibration.marker_measured
    chosen = slice(None) if measured is None else measured

    @functools.cache
    def apart_at(powers: Powers) -> float:
        on, off = (GROWTH**power for power in powers)
        t_us, center_px = track(events, calibration.with_steps_scaled(on, off))
        nearest = np.searchsorted(t_us, at_us).clip(0, len(t_us) - 1)
        return float(np.linalg.norm(center_px[nearest] - known_px, axis=2)[:, chosen].mean())

    if apart_at((0, 0)) < TRUSTED_PX:
        return 1.0, 1.0
    alike = _least(apart_at, ALIKE)
    apart = _least(apart_at, (*ALIKE, *APART))
    gain_apart = GAIN_APART if calibration.recovery_s is None else 0.0
    chosen = apart if apart_at(apart) < (1.0 - gain_apart) * apart_at(alike) else alike
    return GROWTH ** chosen[0], GROWTH ** chosen[1]


def _least(apart_at: Callable[[Powers], float], moves: Iterable[Powers]) -> Powers:
    """Walk from (0, 0) to the neighbour with the least distance, until no gain is worth a move."""
    best = (0, 0)
    while True:
        around = [(best[0] + on, best[1] + off) for on, off in moves]
        within = [powers for powers in around if max(map(abs, powers)) <= MOST_POWER]
        least = min(within, key=apart_at)
        if apart_at(least) > (1.0 - LEAST_GAIN) * apart_at(best):
            return best
        best = least


def track(
    events: BufferedEvents, calibration: Calibration
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return times ``(n,)``, us, and places ``(n, m, 2)``, px, as the tracker finds them.

    Discs are fitted to levels, or to bands where the calibration asks for it.
    """
    # The buffered events are those of white markers, whatever the sensor's are.
    bright = replace(calibration, polarity="white")
    fit = "disc" if bright.band_scale_on is None else "bands"
    tracker = GradedTracker(GradedTrackerConfig(backlash=0.0), bright, fit=fit)
    periods_us = PERIODS_US if bright.band_scale_on is None else BAND_PERIODS_US
    t_us, center_px = [], []
    for window in _windows(events, len(calibration.reference_px), *periods_us):
        tracker.absorb(window)
        t_us.append(window.t_end_us - events.t_start_us)
        center_px.append(tracker.estimate(window.t_end_us).detected_px)
    return np.array(t_us), np.array(center_px)


def _windows(
    events: BufferedEvents, markers: int, period_us: int, longest_us: int
) -> Iterator[EventPacket]:
    """Cut the recording at every period in motion, and more rarely at rest."""
    edges_us = np.arange(0, events.duration_us + period_us, period_us)
    index = events.index_at(edges_us).tolist()
    longest = longest_us // period_us
    start, last = 0, len(edges_us) - 1
    for end in range(1, last + 1):
        enough = index[end] - index[start] >= EVENTS_PER_MARKER * markers
        if enough or end - start >= longest or end == last:
            yield events.packet(start * period_us, end * period_us)
            start = end


def with_tracked_reference(
    events: BufferedEvents, calibration: Calibration, rests_us: NDArray[np.int64]
) -> Calibration:
    """Return a calibration whose reference is where the tracker finds the markers after contacts.

    It is the same calibration without a rest after a contact.

    Args:
        events: The recording, markers brighter than the ground.
        calibration: Its steps are those that suit the tracker.
        rests_us: ``(rests, 2)`` when nothing touched the skin, us since the start of the recording.
            The first one is left out: at it the tracker stands where it was put.
    """
    if len(rests_us) < 2:
        return calibration
    after_us = rests_us[1:]
    t_us, center_px = track(events, calibration)
    length_us = np.diff(after_us, axis=1)[:, 0]
    first = np.searchsorted(t_us, after_us[:, 0] + (CREPT_SHARE * length_us).astype(np.int64))
    last = np.searchsorted(t_us, after_us[:, 1])
    rest_px = np.array([
        np.median(center_px[begin : max(end, begin) + 1], axis=0)
        for begin, end in zip(first.clip(0, len(t_us) - 1), last, strict=True)
    ])  # fmt: skip
    found_px = typical(rest_px, length_us)
    if calibration.marker_measured is not None:
        measured = calibration.marker_measured[:, np.newaxis]
        found_px = np.where(measured, found_px, calibration.reference_px)
    return replace(calibration, reference_px=found_px)
