"""Where the markers went, before anything is known of them but a guess.

A marker that is paler than the others is sighted, but steps of the others' size never erase it from
the map, so that it seems to stand still while it sends events. It is led by its neighbours once;
along that way its own steps show, and with them it is followed like the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.disc_levels import Course, Discs, PixelSteps, led_by_neighbours
from spikingtac.markers.calibration.find_markers import Overview
from spikingtac.markers.calibration.following import Follower
from spikingtac.markers.calibration.recording import moving_events
from spikingtac.markers.calibration.reference import CREPT_SHARE
from spikingtac.markers.calibration.swings import LearnedSteps, learn_steps
from spikingtac.markers.graded.appearance import nearest_marker

# A marker with fewer full swings than this share of the others', but not so few events, was not
# followed.
STUCK_SHARE = 0.1


def first_course(
    look: Overview, index: NDArray[np.int64], still: NDArray[np.int64], discs: Discs
) -> tuple[Course, LearnedSteps]:
    """Follow all markers, pale ones too, and learn what an event of each stands for.

    Args:
        look: The recording, and where its markers were seen at rest.
        index: ``(n,)`` how many events came before each sample.
        still: ``(rests, 3)`` first, typical and last sample of each rest.
        discs: A first guess of how the markers look.
    """
    events, rest_px = look.events, look.markers.center_px
    even = [np.full(events.shape, step, np.float32) for step in (look.steps.on, look.steps.off)]
    length_us = np.diff(look.rests_us, axis=1)[:, 0]
    longest = int(np.where(look.unloaded, length_us, 0).argmax())
    seen = (int(still[longest, 1]), look.maps[longest], rest_px)
    follower = Follower(events, index)
    course = follower.both_ways(seen, discs, PixelSteps(*even))
    learned = learn_steps(events, course, discs, rest_px, look.steps)
    stuck = _stuck(look, learned.swings)
    if stuck.any():
        led = led_by_neighbours(course, seen[0], stuck)
        learned = learn_steps(events, led, discs, rest_px, look.steps)
        course = follower.both_ways(seen, discs, learned.pixel)
        learned = learn_steps(events, course, discs, rest_px, look.steps)
    return course, learned


def _stuck(look: Overview, swings: NDArray[np.float64]) -> NDArray[np.bool_]:
    # Pale markers: they send events, but steps of the others' size never erase them from the map.
    cell = nearest_marker(look.markers.center_px, look.events.size).ravel()
    moving = moving_events(look.events, look.rests_us)
    pixel = look.events.code[moving] >> 1
    sent = np.bincount(cell[pixel], minlength=len(swings))
    return (swings < STUCK_SHARE * np.median(swings)) & (sent > STUCK_SHARE * np.median(sent))


# Samples are so far apart that the markers move by this much between two, on the average.
# (0.2 px is no better on simulated presses, and takes half as long again.)
SAMPLE_PX = 0.5

# Bounds of the samples: short recordings are sampled more finely, long ones more coarsely.
FEWEST_SAMPLES, MOST_SAMPLES = 400, 6_000

# Short recordings of so many markers that this is exceeded are not sampled more finely. (Of
# 1,024 markers, 160 samples are as good as 400.)
FEWEST_FITS = 160_000

# Where in a rest it is sampled. The skin creeps in its first part; the middle one stands for the
# rest.
REST_SHARES = (CREPT_SHARE, 0.8, 0.95)


def choose_samples(look: Overview) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return how many events come before each sample, and which samples lie in rests.

    Args:
        look: The recording, and where its markers were seen at rest.

    Returns:
        ``(n,)`` numbers of events, increasing, and ``(rests, 3)`` the first, the typical and the
        last sample of each rest.
    """
    events = look.events
    # Both rims of a disc that moves by a pixel sweep its diameter, one up and one down a swing.
    diameter_px = 2.0 * look.markers.radius_px * len(look.markers.center_px)
    events_per_px = diameter_px * (1.0 / look.steps.on + 1.0 / look.steps.off)
    fewest = min(FEWEST_SAMPLES, FEWEST_FITS // len(look.markers.center_px))
    apart = min(int(SAMPLE_PX * events_per_px), len(events) // max(fewest, 1))
    apart = max(apart, len(events) // MOST_SAMPLES, 1)
    begin_us, length_us = look.rests_us[:, :1], np.diff(look.rests_us, axis=1)
    rest = events.index_at((begin_us + length_us * np.array(REST_SHARES)).astype(np.int64))
    index = np.unique(
        np.concatenate([np.arange(0, len(events), apart), rest.ravel(), [len(events)]])
    )
    return index, np.searchsorted(index, rest)
