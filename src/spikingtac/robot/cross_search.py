"""The published search: four contacts along the axes, two formulas (Section V-C)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import SearchError
from spikingtac.geometry.hole import Circle, Compensation
from spikingtac.geometry.travel import TravelModel
from spikingtac.robot.prober import Prober, Touched

Vector = NDArray[np.float64]

EAST, WEST = np.array([1.0, 0.0]), np.array([-1.0, 0.0])
NORTH, SOUTH = np.array([0.0, 1.0]), np.array([0.0, -1.0])
LEAST_ROOM_MM = 0.25
"""Opposite readings nearer than this leave no room, mm: a probe pressed against the rim answers
twice within twice the travel; the narrowest hole leaves 0.23 mm plus twice the travel, even at 0.9
of the free way."""

MISFIT_MM = 0.3
"""How far the two chords may contradict each other, mm: twice the difference of the travels."""


def cross_search(prober: Prober, start_mm: Vector) -> list[Touched]:
    """Touch +X and -X from the start, then +Y and -Y from the middle of the two.

    Args:
        prober: Who touches.
        start_mm: ``(2,)`` P0, inside the hole, mm.

    Returns:
        P1 to P4.

    Raises:
        SearchError: No wall was found, or there is no room; the arm is at rest.
        DeviceError: Arm or sensor failed; the arm was told to stop.
    """
    start = np.asarray(start_mm, np.float64)
    first = [prober.touch(start, EAST), prober.touch(start, WEST)]
    require_room(*first)
    middle = np.array([(first[0].reading_mm[0] + first[1].reading_mm[0]) / 2.0, start[1]])
    second = [prober.touch(middle, NORTH), prober.touch(middle, SOUTH)]
    require_room(*second)
    _require_circle(first, second)
    return [*first, *second]


def require_room(one: Touched, other: Touched) -> None:
    """Refuse two opposite contacts at one place.

    Raises:
        SearchError: The probe stands on the rim, or is jammed.
    """
    room_mm = float((one.reading_mm - other.reading_mm) @ one.direction)
    if room_mm < LEAST_ROOM_MM:
        raise SearchError(
            f"the probe touches on both sides within {max(room_mm, 0.0):.3f} mm of "
            f"({one.start_mm[0]:.2f}, {one.start_mm[1]:.2f}) mm: it stands on the rim or is "
            "jammed, or the hole is no wider than the bit; start inside the hole"
        )


def _require_circle(first: list[Touched], second: list[Touched]) -> None:
    """Refuse a first chord that is much shorter or longer than the second says it must be.

    Raises:
        SearchError: Then at least one contact was none: a probe that leans on the rim answers
            where it is let go.
    """
    half_x = float(first[0].reading_mm[0] - first[1].reading_mm[0]) / 2.0
    high, low = float(second[0].reading_mm[1]), float(second[1].reading_mm[1])
    off = float(second[0].start_mm[1]) - (high + low) / 2.0
    expected = math.sqrt(max(((high - low) / 2.0) ** 2 - off**2, 0.0))
    if abs(half_x - expected) > MISFIT_MM:
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
    return _circle(np.array([touch.reading_mm for touch in touches]), sigma_mm).grown(
        Compensation.published().total_mm
    )


def calibrated_circle(touches: list[Touched], travel: TravelModel) -> Circle:
    """Return the paper's estimate with the calibrated travel of each direction.

    Args:
        touches: From :func:`cross_search`.
        travel: The calibration; the bit's heading is not used, its mean reach is.
    """
    direction = np.array([touch.direction for touch in touches])
    reading = np.array([touch.reading_mm for touch in touches])
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    size = travel.travel_mm(angle)
    circle = _circle(reading - size[:, None] * direction, travel.sigma_mm)
    rows = np.column_stack([direction, np.ones(len(direction))])
    gain = np.linalg.pinv(rows).astype(np.float64)
    covariance = circle.covariance_mm2 + travel.systematic_mm2(angle, gain)
    return replace(circle, covariance_mm2=covariance).grown(Compensation().offset_mm)


def _circle(point: Vector, sigma_mm: float) -> Circle:
    """Return centre and R_measured of four points; the covariance is that of four even contacts."""
    center = np.array([point[:2, 0].mean(), point[2:, 1].mean()])
    distance = np.linalg.norm(point - center, axis=1)
    radius = float(distance.mean())
    covariance = np.diag([0.5, 0.5, 0.25]) * sigma_mm**2
    return Circle(center, radius, covariance, distance - radius)
