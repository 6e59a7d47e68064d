"""From readings of touches to a hole, each taken back as its direction and incidence demand.

A motion that meets the wall head-on needs the calibrated travel, all of it along the motion. One
that meets it at an angle beyond the friction cone slides: the rod then bends along the edge of the
cone, and the tip has moved along the wall, which does no harm. So the travel is taken back along
the force. Incidence and the hexagon's reach depend on the hole, hence a few rounds. In them, too, a
contact that lies far off the circle of the others is believed less: one in a thousand is false.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.geometry.hole import Circle, HoleFitConfig, fit_circle
from spikingtac.geometry.travel import TravelModel

Vector = NDArray[np.float64]

ROUNDS = 4
"""Rounds of estimate and taking back: the third changes less than a micrometre."""


@dataclass(frozen=True, kw_only=True)
class TouchFitConfig:
    """How readings become a hole.

    Attributes:
        prior: What is known before; its contact noise is replaced by the calibration's.
        friction: Coulomb coefficient between bit and wall (ours: steel on plastic).
        slip_sigma: Standard deviation that sliding adds to a contact, as a share of the travel
            and of how far beyond the cone the motion lies (ours: friction known to a third).
        doubt_sigma: A contact farther off the circle than this many standard deviations weighs less
            (ours: one honest contact in 370 does).
    """

    prior: HoleFitConfig = field(default_factory=HoleFitConfig)
    friction: float = 0.3
    slip_sigma: float = 0.3
    doubt_sigma: float = 3.0


def estimate_hole(
    reading_mm: Vector,
    direction: Vector,
    start_mm: Vector,
    travel: TravelModel,
    config: TouchFitConfig,
) -> Circle:
    """Estimate a hole from the arm's readings at the decisions.

    Args:
        reading_mm: ``(n, 2)`` readings in the plane of the plate, mm.
        direction: ``(n, 2)`` unit directions of the motions.
        start_mm: ``(2,)`` a place inside the hole, mm: where the search began.
        travel: The calibration.
        config: Prior and friction.

    Returns:
        Hole, with the covariance of contacts and calibration; residuals are those of the contacts.

    Raises:
        ValueError: As :func:`~spikingtac.geometry.hole.fit_circle`, or the shapes differ.
    """
    reading, heading = np.asarray(reading_mm, np.float64), np.asarray(direction, np.float64)
    if reading.shape != heading.shape:
        raise ValueError(f"got readings {reading.shape} and directions {heading.shape}; need equal")
    case = _Case(travel, config)
    circle, normal, sigma = _round(reading, heading, heading, start_mm, case)
    for _ in range(ROUNDS):
        off = np.abs(circle.residual_mm) * case.doubt / (config.doubt_sigma * sigma)
        radius = max(circle.radius_mm, travel.across_flats_mm)
        case = _Case(travel, config, radius, np.maximum(off, 1.0) ** 2)
        circle, normal, sigma = _round(reading, heading, normal, start_mm, case)
    rows = np.column_stack([normal, np.ones(len(normal))])
    gain = circle.covariance_mm2 @ (rows / sigma[:, None] ** 2).T
    angle = np.arctan2(heading[:, 1], heading[:, 0])
    covariance = circle.covariance_mm2 + travel.systematic_mm2(angle, gain)
    return replace(circle, covariance_mm2=covariance)


@dataclass(frozen=True, slots=True)
class _Case:
    travel: TravelModel
    config: TouchFitConfig
    radius_mm: float = math.inf
    doubt: Vector | float = 1.0  # by what the standard deviation of a contact is multiplied


def _round(
    reading: Vector, heading: Vector, normal: Vector, start_mm: Vector, case: _Case
) -> tuple[Circle, Vector, Vector]:
    """Take the readings back along the present normals; return circle, new normals, sigmas."""
    force, slid = _force(heading, normal, case.config.friction)
    size = case.travel.travel_mm(np.arctan2(force[:, 1], force[:, 0]))
    reach = case.travel.reach_mm(np.arctan2(normal[:, 1], normal[:, 0]), case.radius_mm)
    center = reading - size[:, None] * force
    slip = case.config.slip_sigma * np.abs(size) * slid
    sigma = case.doubt * np.hypot(case.travel.sigma_mm, slip)
    circle = fit_circle(center + reach[:, None] * normal, start_mm, case.config.prior, sigma)
    away = center - circle.center_mm
    length = np.maximum(np.linalg.norm(away, axis=1), np.finfo(float).tiny)
    return circle, away / length[:, None], sigma


def _force(heading: Vector, normal: Vector, friction: float) -> tuple[Vector, Vector]:
    """Return the force's directions ``(n, 2)`` and by how much (rad) the motions slid ``(n,)``."""
    cone = math.atan(friction)
    turn = np.arctan2(
        normal[:, 0] * heading[:, 1] - normal[:, 1] * heading[:, 0], (normal * heading).sum(axis=1)
    )
    kept = np.clip(turn, -cone, cone)
    cos, sin = np.cos(kept), np.sin(kept)
    x, y = normal.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1), np.abs(turn - kept)
