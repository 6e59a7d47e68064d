"""The adaptive search: each touch has the direction that reduces the uncertainty most.

The first two touches are opposite and give a chord; the third starts at its middle, at a right
angle. These determine a circle. Every further touch starts at its centre, so that it meets the wall
head-on. A chord far from the centre meets the wall at an angle: the bit slides, and the force is
outside of the calibrated directions. Such a chord only locates the hole; the estimate does not use
it.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from spikingtac.errors import ConfigError, SearchError
from spikingtac.geometry.hole import PRIOR_SIGMA_MM, Circle, estimate_hole
from spikingtac.geometry.travel import TravelModel
from spikingtac.robot.prober import Prober, Touched
from spikingtac.types import FloatArray

LEAST_CONTACTS = 3  # A circle has three unknowns.
MOST_CONTACTS = 12  # Contacts of a search unless told.

# Least difference of the radii of hole and bit, mm; the plate's narrowest hole has 0.27.
LEAST_CLEARANCE_MM = 0.1

# Largest angle to the wall's normal of a head-on touch, rad: it is inside the friction cone of
# 0.18, the least friction of steel on dry plastic.
HEAD_ON_RAD = math.radians(10.0)
FIRST_RAD = math.pi / 4  # Direction of the first touch, rad (inside the sector).

# Direction along the pads, rad: a rod that turns in their plane moves the markers, one that tilts
# out of it hardly does.
AXIS_RAD = 0.0

# Largest angle between a touch and this axis, either way, rad (four contacts at 45 degrees
# give as much information as four along the axes).
SECTOR_RAD = math.radians(50.0)

# Free travel that a touch needs before the wall, mm (arm and detector settle there).
RUN_UP_MM = 0.1

# Least distance of opposite readings besides the travel, mm: a probe on the rim is detected on both
# sides at once, which leaves nothing.
LEAST_FREE_MM = 0.06

# Number of directions that are compared for the next touch (five degrees apart).
DIRECTIONS = 72

# Directions with an uncertainty within this fraction of the best count as equal. The one
# farthest from all touched directions is taken, since neighbours share errors.
INDIFFERENCE = 0.05
MISFIT_SIGMA = 6.0  # Largest distance of a contact from the circle, in standard deviations.


@dataclass(frozen=True, slots=True)
class FoundHole:
    """What a search found.

    Attributes:
        circle: The hole and its uncertainty.
        touches: The contacts that the estimate uses, in order.
    """

    circle: Circle
    touches: tuple[Touched, ...]


class _MisfitError(SearchError):
    """The contacts make no circle, or one that is no wider than the bit."""


def probe_hole(
    prober: Prober,
    travel: TravelModel,
    start_mm: FloatArray | None = None,
    contacts: int = MOST_CONTACTS,
    center_sigma_mm: float = 0.0,
) -> FoundHole:
    """Find centre and radius of a hole by touch; the probe stands in it.

    Args:
        prober: Makes the touches, as :class:`~spikingtac.robot.prober.ArmProber` does with an arm,
            the windows of its sensor and a detector.
        travel: The calibration; see :func:`~spikingtac.geometry.travel.fit_travel`.
        start_mm: ``(2,)`` a place inside the hole, mm; where the probe stands unless given.
        contacts: Largest number of contacts, at least 3.
        center_sigma_mm: The search ends earlier when the standard deviation of the centre along
            each axis is below this, mm; 0 never ends it early.

    Raises:
        ConfigError: There may be fewer than three contacts.
        SearchError: No wall was found, there is no room, or the contacts make no circle; the arm is
            at rest.
        DeviceError: Arm or sensor failed; the arm was commanded to stop.
    """
    if contacts < LEAST_CONTACTS:
        raise ConfigError(f"contacts is {contacts}, it must be at least {LEAST_CONTACTS}")
    start = np.asarray(prober.place_mm() if start_mm is None else start_mm, np.float64)

    def is_enough(kept: list[Touched]) -> bool:
        if len(kept) >= contacts:
            return True
        return bool((hole_around(kept, travel).sigma_mm[:2] <= center_sigma_mm).all())

    # Which of the first three contacts was a false one is not known: search once more.
    with contextlib.suppress(_MisfitError):
        return _search(prober, travel, start, is_enough)
    return _search(prober, travel, start, is_enough)


def _search(
    prober: Prober,
    travel: TravelModel,
    start: FloatArray,
    is_enough: Callable[[list[Touched]], bool],
) -> FoundHole:
    touches = _chord(prober, travel, start)
    across = np.array([-touches[0].direction[1], touches[0].direction[0]])
    touches.append(prober.touch(_middle(*touches), across))
    circle = _checked(touches, travel)
    kept = [one for one in touches if _is_head_on(one, circle)]
    while len(kept) < LEAST_CONTACTS or not is_enough(kept):
        # Touch in the best direction; repeat a touch that does not fit the others.
        middle, direction = hole_around(touches, travel).center_mm, best_direction(kept, travel)
        touched = prober.touch(middle, direction)
        if _objection(hole_around([*touches, touched], travel), travel) is not None:
            touched = prober.touch(middle, direction)
        kept.append(touched)
        touches = [*touches, touched] if len(kept) <= LEAST_CONTACTS else kept
        _checked(touches, travel)
    return FoundHole(_checked(kept, travel), tuple(kept))


def _chord(prober: Prober, travel: TravelModel, start: FloatArray) -> list[Touched]:
    """Touch in both directions of a line; repeat a touch that began too near the wall."""
    ahead = np.array([math.cos(FIRST_RAD), math.sin(FIRST_RAD)])
    touches = [prober.touch(start, ahead), prober.touch(start, -ahead)]
    require_room(touches[0], touches[1], travel)
    middle = _middle(*touches)
    for number, touch in enumerate(touches):
        x, y = touch.direction
        if touch.run_mm - float(travel.travel_mm(np.arctan2(y, x))) < RUN_UP_MM:
            touches[number] = prober.touch(middle, touch.direction)
    return touches


def require_room(one: Touched, other: Touched, travel: TravelModel) -> None:
    """Refuse two opposite contacts at one place.

    Raises:
        SearchError: The probe stands on the rim, or is jammed.
    """
    room_mm = float((one.reading_mm - other.reading_mm) @ one.direction)
    x, y = np.array([one.direction, other.direction]).T
    if room_mm < LEAST_FREE_MM + float(travel.travel_mm(np.arctan2(y, x)).sum()):
        raise SearchError(
            f"the probe touches on both sides within {max(room_mm, 0.0):.3f} mm of "
            f"({one.start_mm[0]:.2f}, {one.start_mm[1]:.2f}) mm: it stands on the rim or is "
            "jammed, or the hole is no wider than the bit; start inside the hole"
        )


def best_direction(touches: Sequence[Touched], travel: TravelModel) -> FloatArray:
    """Return the unit direction ``(2,)`` that reduces the uncertainty most.

    The covariance after a contact is known beforehand for each candidate, since the information of
    a contact depends on its direction alone. The best candidate has the least trace.

    Args:
        touches: The contacts that the estimate uses so far, head-on; may be none.
        travel: The calibration.
    """
    angle = np.arange(DIRECTIONS) * (2.0 * math.pi / DIRECTIONS)
    angle = angle[np.abs(np.cos(angle - AXIS_RAD)) >= math.cos(SECTOR_RAD) - 1e-9]
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    touched = np.array([one.direction for one in touches], np.float64).reshape(-1, 2)
    known = np.column_stack([touched, np.ones(len(touched))])
    information = np.diag(np.array(PRIOR_SIGMA_MM) ** -2.0) + known.T @ known / travel.sigma_mm**2
    covariance = np.linalg.inv(information)
    row = np.column_stack([unit, np.ones(len(unit))])
    spread = row @ covariance
    gain = (spread**2).sum(axis=1) / (travel.sigma_mm**2 + (spread * row).sum(axis=1))
    left = float(np.trace(covariance)) - gain
    nearest = (unit @ touched.T).max(axis=1, initial=-1.0)
    good = left <= float(left.min()) * (1.0 + INDIFFERENCE)
    return unit[np.flatnonzero(good)[int(nearest[good].argmin())]]


def _checked(touches: list[Touched], travel: TravelModel) -> Circle:
    """Return the estimate, if it is valid.

    Raises:
        SearchError: The contacts make no circle, or one that is no wider than the bit.
    """
    circle = hole_around(touches, travel)
    if (objection := _objection(circle, travel)) is not None:
        raise _MisfitError(objection)
    return circle


def _objection(circle: Circle, travel: TravelModel) -> str | None:
    """Return why a circle is not valid, or None."""
    corner_mm = travel.across_flats_mm / math.sqrt(3.0)
    if circle.radius_mm < corner_mm + LEAST_CLEARANCE_MM:
        return (
            f"the contacts make a hole of {circle.radius_mm:.2f} mm radius, no wider than the "
            f"bit ({corner_mm:.2f} mm): it stands on the rim or is jammed; start inside a hole"
        )
    worst = float(np.abs(circle.residual_mm).max())
    if worst > MISFIT_SIGMA * travel.sigma_mm:
        return (
            f"the contacts make no circle: one lies {worst:.3f} mm off, expected are "
            f"{travel.sigma_mm:.3f} mm; a false contact, a hole that is not round, or a "
            "probe that slipped: start again, or calibrate the travel anew"
        )
    return None


def hole_around(touches: Sequence[Touched], travel: TravelModel) -> Circle:
    """Return the hole that fits some touches; the mean of their starts is inside it.

    Raises:
        ValueError: There is no touch.
    """
    reading = np.array([touch.reading_mm for touch in touches])
    direction = np.array([touch.direction for touch in touches])
    inside = np.mean([touch.start_mm for touch in touches], axis=0)
    return estimate_hole(reading, direction, inside, travel)


def _is_head_on(touch: Touched, circle: Circle) -> bool:
    away = touch.reading_mm - circle.center_mm
    return float(away @ touch.direction) / float(np.linalg.norm(away)) >= math.cos(HEAD_ON_RAD)


def _middle(one: Touched, other: Touched) -> FloatArray:
    return (one.reading_mm + other.reading_mm) / 2.0
