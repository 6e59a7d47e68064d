"""The published search: four contacts along the axes, two formulas (Section V-C)."""

import math
from dataclasses import replace

import numpy as np

from spikingtac.errors import SearchError
from spikingtac.geometry import (
    FRICTION,
    MEAN_REACH_MM,
    REACH_SIGMA_MM,
    SLIP_SIGMA,
    Circle,
    TravelModel,
)
from spikingtac.robot import LEAST_FREE_MM, Prober, Touched, require_room
from spikingtac.types import FloatArray

EAST, NORTH = np.array([1.0, 0.0]), np.array([0.0, 1.0])  # Directions +X and +Y of the search.

# How far the two chords may contradict each other, mm: five times the spread of a touch that is not
# conditioned.
MISFIT_MM = 0.25

# Of the angle at which a chord meets the wall: a start at 0.9 of the free way meets it at 0.44.
LEAST_COSINE = 0.2


# The paper's constants, mm: half the bit's width, and delta_crit.
OFFSET_MM, TRAVEL_MM = 0.375, 0.4


def cross_search(prober: Prober, start_mm: FloatArray, travel: TravelModel) -> list[Touched]:
    """Touch +X and -X from the start, then +Y and -Y from the middle of the two.

    Args:
        prober: Makes the touches.
        start_mm: ``(2,)`` P0, inside the hole, mm.
        travel: The calibration, to detect a bad start sooner; the motions do not depend on it.

    Returns:
        P1 to P4.

    Raises:
        SearchError: No wall was found, or there is no room; the arm is at rest.
        DeviceError: Arm or sensor failed; the arm was commanded to stop.
    """
    start = np.asarray(start_mm, np.float64)
    first = [prober.touch(start, EAST), prober.touch(start, -EAST)]
    require_room(first[0], first[1], travel)
    middle = np.array([(first[0].reading_mm[0] + first[1].reading_mm[0]) / 2.0, start[1]])
    second = [prober.touch(middle, NORTH), prober.touch(middle, -NORTH)]
    require_room(second[0], second[1], travel)
    _require_circle([*first, *second], travel)
    return [*first, *second]


def _taken(
    touches: list[Touched], travel: TravelModel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return direction ``(n, 2)`` and calibrated travel ``(n,)``, mm, and the walls ``(n, 2)``."""
    direction = np.array([touch.direction for touch in touches])
    taken_mm = travel.travel_mm(np.arctan2(direction[:, 1], direction[:, 0]))
    reading = np.array([touch.reading_mm for touch in touches])
    return direction, taken_mm, reading - taken_mm[:, None] * direction


def _require_circle(touches: list[Touched], travel: TravelModel) -> None:
    """Refuse a first chord whose length contradicts the second chord.

    Raises:
        SearchError: Then at least one contact was none.
    """
    point = _taken(touches, travel)[2]
    half_x, half_y = (point[0, 0] - point[1, 0]) / 2.0, (point[2, 1] - point[3, 1]) / 2.0
    off = float(touches[2].start_mm[1] - point[2:, 1].mean())
    expected = math.sqrt(max(half_y**2 - off**2, 0.0))
    slope = float(half_y) / max(expected, LEAST_FREE_MM)  # how the misfit grows off the middle
    if abs(float(half_x) - expected) > MISFIT_MM * max(slope, 1.0):
        raise SearchError(
            f"the contacts make no circle: half the chord along X is {half_x:.2f} mm, the contacts "
            f"along Y demand {expected:.2f} mm; the probe leans on the rim, a contact was false, "
            "or the hole is not round: start again inside the hole"
        )


def published_circle(touches: list[Touched], sigma_mm: float) -> Circle:
    """Return the paper's estimate with the paper's constants, 0.375 and 0.4 mm.

    Args:
        touches: From :func:`cross_search`.
        sigma_mm: Standard deviation of one contact, mm; the paper states none.
    """
    circle = _circle(np.array([touch.reading_mm for touch in touches]), sigma_mm)
    return replace(circle, radius_mm=circle.radius_mm + (OFFSET_MM - TRAVEL_MM))


def calibrated_circle(touches: list[Touched], travel: TravelModel) -> Circle:
    """Return the paper's estimate with the calibrated travel of each direction.

    Args:
        touches: From :func:`cross_search`.
        travel: The calibration; the bit's heading is not used, its mean reach is.
    """
    direction, size, point = _taken(touches, travel)
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    circle = _circle(point, travel.sigma_mm)
    rows = np.column_stack([direction, np.ones(len(direction))])
    gain = np.linalg.pinv(rows).astype(np.float64)
    # A plain touch slides and remembers: it is nowhere surer than the mean of its calibration.
    known = np.maximum(travel.sigma_at_mm(angle), travel.sigma_mm)
    sigma = _spread_mm(point - circle.center_mm, direction, size, known)
    covariance = (gain * sigma**2) @ gain.T + travel.systematic_mm2(angle, gain)
    covariance[2, 2] += REACH_SIGMA_MM**2 / 2.0  # the same reach at opposite contacts
    radius_mm = circle.radius_mm + MEAN_REACH_MM
    return replace(circle, radius_mm=radius_mm, covariance_mm2=covariance)


def _spread_mm(
    away: FloatArray, direction: FloatArray, size: FloatArray, sigma_mm: FloatArray
) -> FloatArray:
    """Return the standard deviation ``(n,)`` of each contact along its motion, mm.

    A chord off the middle meets the wall at an angle: an error along the normal is longer along the
    motion, and beyond the friction cone the tip slides.
    """
    cosine = (away * direction).sum(axis=1) / np.linalg.norm(away, axis=1)
    turn = np.arccos(np.clip(cosine, LEAST_COSINE, 1.0))
    slid = np.maximum(turn - math.atan(FRICTION), 0.0)
    return np.hypot(sigma_mm, SLIP_SIGMA * np.abs(size) * slid) / np.cos(turn)


def _circle(point: FloatArray, sigma_mm: float) -> Circle:
    """Return centre and R_measured of four points; the covariance is that of four even contacts."""
    center = np.array([point[:2, 0].mean(), point[2:, 1].mean()])
    distance = np.linalg.norm(point - center, axis=1)
    radius = float(distance.mean())
    return Circle(center, radius, np.diag([0.5, 0.5, 0.25]) * sigma_mm**2, distance - radius)
