"""The project's search: each touch goes where it is expected to teach most.

The first two touches are opposite and find a chord, the third leaves its middle at a right angle;
from then on there is a circle, and every touch starts at its centre, so that it meets the wall
head-on, in the direction that makes the stated uncertainty of centre and radius smallest. A chord
far from the centre meets the wall at an angle, where the bit slides and the force points out of the
calibrated directions: such a chord finds the hole, and the estimate does not rest on it.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, SearchError
from spikingtac.geometry.hole import Circle
from spikingtac.geometry.touch_fit import TouchFitConfig, estimate_hole
from spikingtac.geometry.travel import TravelModel
from spikingtac.robot.cross_search import require_room
from spikingtac.robot.prober import Prober, Touched

Vector = NDArray[np.float64]

LEAST_CONTACTS = 3
"""A circle has three unknowns."""
LEAST_CLEARANCE_MM = 0.1
"""A hole must be this much wider than the bit's corners, mm; the plate's narrowest is by 0.27."""
SEARCHES = 2
"""Searches of a hole before it is given up: one false contact among the first cannot be named."""
HEAD_ON_RAD = math.radians(10.0)
"""Nearer to the wall's normal a touch is head-on: inside the cone of a friction of 0.18, the least
of steel on dry plastic."""


@dataclass(frozen=True, kw_only=True)
class AdaptiveSearchConfig:
    """When to end, and what to choose from.

    Attributes:
        contacts: Most contacts.
        center_sigma_mm: End before that, once the centre's stated standard deviation along each
            axis is below this, mm; 0 never ends early.
        first_rad: Direction of the first touch, rad.
        axis_rad: Direction along the pads, rad: a rod that turns in the pads' plane is felt well,
            one that tilts out of it hardly moves the markers.
        sector_rad: Directions farther than this from the axis, either way, are not touched (ours:
            50 degrees; four contacts at 45 degrees tell as much as four along the axes).
        run_up_mm: Free way that a touch needs before the wall, mm: arm and detector settle there.
        directions: How many directions are compared for the next touch.
        indifference: Directions whose uncertainty is within this share of the best are as good;
            the one farthest from all that were touched is taken, since neighbours share errors.
        misfit_sigma: Largest distance of a contact from the circle, in standard deviations.
        fit: How contacts become a circle.
    """

    contacts: int = 12
    center_sigma_mm: float = 0.0
    first_rad: float = math.pi / 4
    axis_rad: float = 0.0
    sector_rad: float = math.radians(50.0)
    run_up_mm: float = 0.1
    directions: int = 72
    indifference: float = 0.05
    misfit_sigma: float = 6.0
    fit: TouchFitConfig = field(default_factory=TouchFitConfig)

    def __post_init__(self) -> None:
        if self.contacts < LEAST_CONTACTS or self.directions < LEAST_CONTACTS:
            raise ConfigError(
                f"contacts is {self.contacts} and directions {self.directions}; "
                f"both must be at least {LEAST_CONTACTS}"
            )


@dataclass(frozen=True, slots=True)
class FoundHole:
    """What a search found.

    Attributes:
        circle: The hole and its uncertainty.
        touches: The contacts that it rests on, in order; those that only found the hole are left
            out.
    """

    circle: Circle
    touches: tuple[Touched, ...]


class _MisfitError(SearchError):
    """The contacts make no hole that the bit fits into."""


class AdaptiveSearch:
    """Searches one hole.

    Args:
        prober: Who touches.
        travel: The calibration.
        config: When to end.
    """

    def __init__(self, prober: Prober, travel: TravelModel, config: AdaptiveSearchConfig) -> None:
        self._prober = prober
        self._travel = travel
        self._config = config

    def run(self, start_mm: Vector) -> FoundHole:
        """Search from a place inside the hole.

        Args:
            start_mm: ``(2,)``, mm.

        Raises:
            SearchError: No wall was found, there is no room, or the contacts make no circle; the
                arm is at rest.
            DeviceError: Arm or sensor failed; the arm was told to stop.
        """
        start = np.asarray(start_mm, np.float64)
        for _ in range(SEARCHES - 1):
            with contextlib.suppress(_MisfitError):
                return self._search(start)
        return self._search(start)

    def _search(self, start: Vector) -> FoundHole:
        touches = self._chord(start)
        touches.append(self._across(touches))
        circle = self._checked(touches)
        kept = [one for one in touches if _is_head_on(one, circle)]
        while len(kept) < LEAST_CONTACTS or not self._is_enough(kept):
            kept.append(self._next(touches, kept))
            touches = [*touches, kept[-1]] if len(kept) <= LEAST_CONTACTS else kept
            self._checked(touches)
        return FoundHole(self._checked(kept), tuple(kept))

    def circle(self, touches: Sequence[Touched]) -> Circle:
        """Return the estimate from some contacts."""
        return hole_around(touches, self._travel, self._config.fit)

    def _chord(self, start: Vector) -> list[Touched]:
        """Touch both ways along a line; a touch that began too near the wall is made again."""
        first = self._config.first_rad
        ahead = np.array([math.cos(first), math.sin(first)])
        one = self._prober.touch(start, ahead)
        other = self._prober.touch(start, -ahead)
        require_room(one, other, self._travel)
        middle = _middle(one, other)
        touches = [one, other]
        for number, touch in enumerate(touches):
            travel = float(self._travel.travel_mm(_angle(touch.direction)))
            if touch.run_mm - travel < self._config.run_up_mm:
                touches[number] = self._prober.touch(middle, touch.direction)
        return touches

    def _across(self, chord: list[Touched]) -> Touched:
        across = np.array([-chord[0].direction[1], chord[0].direction[0]])
        return self._prober.touch(_middle(chord[0], chord[1]), across)

    def _next(self, touches: list[Touched], kept: list[Touched]) -> Touched:
        """Touch where it teaches most; a touch that does not fit the others is made again."""
        middle, direction = self.circle(touches).center_mm, self.best_direction(kept)
        touched = self._prober.touch(middle, direction)
        if self._objection(self.circle([*touches, touched])) is None:
            return touched
        return self._prober.touch(middle, direction)

    def best_direction(self, touches: list[Touched]) -> Vector:
        """Return the unit direction ``(2,)`` that is expected to teach most.

        For each candidate the covariance after one more contact there is known beforehand (the
        information of a contact depends on its direction, not on its outcome); the one with the
        least trace is the best.

        Args:
            touches: The contacts that the estimate rests on so far, head-on; may be none.
        """
        config = self._config
        angle = np.arange(config.directions) * (2.0 * math.pi / config.directions)
        inside = np.abs(np.cos(angle - config.axis_rad)) >= math.cos(config.sector_rad) - 1e-9
        angle = angle[inside]
        unit = np.column_stack([np.cos(angle), np.sin(angle)])
        touched = np.array([one.direction for one in touches], np.float64).reshape(-1, 2)
        covariance = self._covariance(touched)
        row = np.column_stack([unit, np.ones(len(unit))])
        spread = row @ covariance
        gain = (spread**2).sum(axis=1) / (self._travel.sigma_mm**2 + (spread * row).sum(axis=1))
        left = float(np.trace(covariance)) - gain
        nearest = (unit @ touched.T).max(axis=1, initial=-1.0)
        good = left <= float(left.min()) * (1.0 + config.indifference)
        return unit[np.flatnonzero(good)[int(nearest[good].argmin())]]

    def _covariance(self, direction: Vector) -> Vector:
        """Return the covariance ``(3, 3)`` that contacts in some directions ``(n, 2)`` leave."""
        prior = self._config.fit.prior
        known = np.diag([prior.center_sigma_mm**-2.0] * 2 + [prior.radius_sigma_mm**-2.0])
        row = np.column_stack([direction, np.ones(len(direction))])
        return np.linalg.inv(known + row.T @ row / self._travel.sigma_mm**2).astype(np.float64)

    def _is_enough(self, kept: list[Touched]) -> bool:
        if len(kept) >= self._config.contacts:
            return True
        sigma = self.circle(kept).sigma_mm
        return bool((sigma[:2] <= self._config.center_sigma_mm).all())

    def _checked(self, touches: list[Touched]) -> Circle:
        """Return the estimate, where it is one.

        Raises:
            SearchError: The contacts make no circle, or one that is no wider than the bit.
        """
        circle = self.circle(touches)
        objection = self._objection(circle)
        if objection is not None:
            raise _MisfitError(objection)
        return circle

    def _objection(self, circle: Circle) -> str | None:
        """Return what speaks against a circle."""
        corner_mm = self._travel.across_flats_mm / math.sqrt(3.0)
        if circle.radius_mm < corner_mm + LEAST_CLEARANCE_MM:
            return (
                f"the contacts make a hole of {circle.radius_mm:.2f} mm radius, no wider than the "
                f"bit ({corner_mm:.2f} mm): it stands on the rim or is jammed; start inside a hole"
            )
        worst = float(np.abs(circle.residual_mm).max())
        if worst > self._config.misfit_sigma * self._travel.sigma_mm:
            return (
                f"the contacts make no circle: one lies {worst:.3f} mm off, expected are "
                f"{self._travel.sigma_mm:.3f} mm; a false contact, a hole that is not round, or a "
                "probe that slipped: start again, or calibrate the travel anew"
            )
        return None


def hole_around(touches: Sequence[Touched], travel: TravelModel, config: TouchFitConfig) -> Circle:
    """Return the hole that some touches tell of; they began inside it, and so did their mean.

    Raises:
        ValueError: There is no touch.
    """
    reading = np.array([touch.reading_mm for touch in touches])
    direction = np.array([touch.direction for touch in touches])
    inside = np.mean([touch.start_mm for touch in touches], axis=0)
    return estimate_hole(reading, direction, inside, travel, config)


def _angle(direction: Vector) -> Vector:
    return np.arctan2(direction[1], direction[0])


def _is_head_on(touch: Touched, circle: Circle) -> bool:
    away = touch.reading_mm - circle.center_mm
    cosine = float(away @ touch.direction) / float(np.linalg.norm(away))
    return cosine >= math.cos(HEAD_ON_RAD)


def _middle(one: Touched, other: Touched) -> Vector:
    return (one.reading_mm + other.reading_mm) / 2.0
