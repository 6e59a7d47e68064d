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

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.disc_levels import Course, Discs, PixelSteps
from spikingtac.markers.calibration.level_maps import MeanSteps
from spikingtac.markers.calibration.recording import BufferedEvents
from spikingtac.markers.calibration.swing_counts import count_swings
from spikingtac.markers.graded.appearance import nearest_marker

# Swings at its neighbours' counts that each marker is given beforehand: light and lens change
# slowly over the skin.
NEIGHBOUR_SWINGS = 10.0

PIXEL_SWINGS = 3.0  # Swings at its marker's counts that each pixel is given beforehand.

FEWEST_SWINGS = 50.0  # Full swings in all below which the sensor's mean steps are kept.

FEWEST_EVENTS = 0.3  # Least mean count of a full swing: a rarer event tells nothing.

STEP_BOUNDS = (0.02, 1.0)  # Least and largest step.


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
    by_marker, by_pixel = count_swings(events, course, discs)
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


"""Events that come so many samples late still count for a swing."""
