"""Pass two of the calibration: follow the markers back and forth, and look at them at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.candidates import Sighting
from spikingtac.markers.calibration.contrast_steps import ContrastSteps
from spikingtac.markers.calibration.marker_course import Course, follow, refit
from spikingtac.markers.calibration.profile_fit import ProfileFit, fit_profile
from spikingtac.markers.calibration.reference import mean_pitch_px, unloaded
from spikingtac.markers.calibration.slide_map import SlideMap
from spikingtac.markers.calibration.slides import Slides
from spikingtac.markers.profile import DiscProfile

MOST_RESTS = 32
"""Rests that are looked at, spread over the recording: each keeps a map in memory."""

REFITS = 2
"""Times that positions and radii are fitted anew in turn, each with the other's latest."""


@dataclass(frozen=True, slots=True)
class RestCourse:
    """The markers that were followed, at the unloaded rests.

    Attributes:
        marker: ``(k,)`` which markers were followed.
        position_px: ``(rests, k, 2)`` mean of both directions, px.
        span_us: ``(rests, 2)`` when, us of the recording's own clock.
        fit: Profile and radii.
        agreement: ``(k,)`` mean share of the edge that agreed with the fit, of the worse direction.
    """

    marker: NDArray[np.int64]
    position_px: NDArray[np.float64]
    span_us: NDArray[np.int64]
    fit: ProfileFit
    agreement: NDArray[np.float64]

    @property
    def scatter_px(self) -> NDArray[np.float64]:
        """``(k,)`` rms distance of a marker's rests from their mean, px."""
        off = self.position_px - self.position_px.mean(axis=0)
        return np.sqrt((off**2).sum(axis=2).mean(axis=0))


def watch_rests(
    slides: Slides,
    steps: ContrastSteps,
    rests_us: NDArray[np.int64],
    sighting: Sighting,
    start: tuple[DiscProfile, int],
) -> RestCourse:
    """Follow the sighted markers through all slides and fit them at rest.

    Args:
        slides: The recording.
        steps: What one event of each pixel stands for.
        rests_us: ``(n, 2)`` rests, us since the start; without any, the whole recording counts as
            one.
        sighting: Where the markers were seen.
        start: A first guess of the profile, and the time between positions, us.

    Raises:
        CalibrationError: The markers rest nowhere without load.
    """
    profile, sample_us = start
    if not len(rests_us):
        rests_us = np.array([[0, slides.duration_us]], np.int64)
    rests_us = rests_us[np.unique(np.linspace(0, len(rests_us) - 1, MOST_RESTS).astype(int))]
    marker = np.setdiff1d(np.arange(len(sighting.center_px)), sighting.grid.missing)
    times_us = np.arange(0, slides.duration_us + 1, sample_us, dtype=np.int64)
    keep = rests_us.mean(axis=1).astype(np.int64) // sample_us
    courses = _both_ways(slides, steps, (sighting, marker), profile, (times_us, keep))
    course_px = 0.5 * (courses[0].position_px + courses[1].position_px)
    rest_px = np.array([_settled(course_px, times_us, rest) for rest in rests_us])
    free = unloaded(rest_px, mean_pitch_px(sighting.center_px, sighting.grid.shape))
    maps = [0.5 * (one + other) for one, other in zip(*(c.maps for c in courses), strict=True)]
    maps = [level for level, chosen in zip(maps, free, strict=True) if chosen]
    position_px, radius_px = course_px[keep[free]], sighting.radius_px[marker]
    step = 0.5 * (steps.mean_on + steps.mean_off)
    fit = fit_profile(maps, position_px, radius_px, profile, step)
    for _ in range(REFITS):
        position_px = refit(maps, position_px, fit.radius_px, fit.profile)
        fit = fit_profile(maps, position_px, fit.radius_px, fit.profile, step)
    agreement = np.minimum(*(course.agreement.mean(axis=0) for course in courses))
    return RestCourse(marker, position_px, slides.t_start_us + rests_us[free], fit, agreement)


def _settled(
    course_px: NDArray[np.float64], times_us: NDArray[np.int64], rest_us: NDArray[np.int64]
) -> NDArray[np.float64]:
    inside = (times_us >= rest_us[0]) & (times_us <= rest_us[1])
    if not inside.any():
        inside[np.abs(times_us - rest_us.mean()).argmin()] = True
    return np.median(course_px[inside], axis=0)


def _both_ways(
    slides: Slides,
    steps: ContrastSteps,
    seen: tuple[Sighting, NDArray[np.int64]],
    profile: DiscProfile,
    times: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> tuple[Course, Course]:
    # On to the end from where the grid was seen, all the way back, and forth with the map that the
    # way back left at the beginning.
    sighting, marker = seen
    times_us, keep = times
    index = slides.index_at(times_us)
    radius_px, position_px = sighting.radius_px[marker], sighting.center_px[marker]
    none = np.empty(0, np.int64)
    late = index[index >= sighting.index]
    if len(late):
        onward = SlideMap(slides, steps)
        onward.move_to(sighting.index)
        position_px = follow(onward, late, position_px, radius_px, profile, none).position_px[-1]
    backward = SlideMap(slides, steps, backward=True, level=sighting.level)
    back = follow(backward, index, position_px, radius_px, profile, keep)
    backward.move_to(0)
    forward = SlideMap(slides, steps, level=backward.level)
    forth = follow(forward, index, back.position_px[0], radius_px, profile, keep)
    return back, forth
