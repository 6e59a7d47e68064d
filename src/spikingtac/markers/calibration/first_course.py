"""Where the markers went, before anything is known of them but a guess.

A marker that is paler than the others is sighted, but steps of the others' size never erase it from
the map, so that it seems to stand still while it sends events. It is led by its neighbours once;
along that way its own steps show, and with them it is followed like the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.course import Course, PixelSteps, led_by_neighbours
from spikingtac.markers.calibration.disc_levels import Discs
from spikingtac.markers.calibration.finding.rest import moving_events
from spikingtac.markers.calibration.finding.sighting import Look
from spikingtac.markers.calibration.following import Follower
from spikingtac.markers.calibration.swings import LearnedSteps, learn_steps
from spikingtac.markers.graded.appearance import nearest_marker

STUCK_SHARE = 0.1
"""A marker with fewer full swings than this share of the others', but not so few events, was not
followed."""


def first_course(
    look: Look, index: NDArray[np.int64], still: NDArray[np.int64], discs: Discs
) -> tuple[Course, LearnedSteps]:
    """Follow all markers, pale ones too, and learn what an event of each stands for.

    Args:
        look: The recording, and where its markers were seen at rest.
        index: ``(n,)`` how many events came before each sample.
        still: ``(rests, 3)`` first, typical and last sample of each rest.
        discs: A first guess of how the markers look.
    """
    events, rest_px = look.events, look.sighting.center_px
    even = [np.full(events.shape, step, np.float32) for step in (look.steps.on, look.steps.off)]
    longest = int(np.where(look.unloaded, look.length_us, 0).argmax())
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


def _stuck(look: Look, swings: NDArray[np.float64]) -> NDArray[np.bool_]:
    # Pale markers: they send events, but steps of the others' size never erase them from the map.
    cell = nearest_marker(look.sighting.center_px, look.events.size).ravel()
    moving = moving_events(look.events, look.rests_us)
    pixel = look.events.code[moving] >> 1
    sent = np.bincount(cell[pixel], minlength=len(swings))
    return (swings < STUCK_SHARE * np.median(swings)) & (sent > STUCK_SHARE * np.median(sent))
