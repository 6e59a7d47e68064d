"""From readings of touches to a hole; each reading is corrected for its direction and incidence.

A motion that meets the wall head-on has the calibrated travel along its direction. A motion at an
angle beyond the friction cone slides: the rod bends along the edge of the cone, and the tip moves
along the wall. The travel is therefore subtracted along the force. Incidence and the hexagon's
reach depend on the hole, so the fit is repeated a few times. Contacts far off the circle get less
weight, since one in a thousand is false.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from spikingtac.geometry.hole import TINY, Circle, HoleFitConfig, fit_circle
from spikingtac.geometry.travel import TravelModel
from spikingtac.types import FloatArray

ROUNDS = 4  # Number of repeated fits: the third one changes the estimate by less than a micrometre.


@dataclass(frozen=True, kw_only=True)
class TouchFitConfig:
    """The settings of the estimate.

    Attributes:
        prior: Prior of centre and radius.
        friction: Coulomb coefficient between bit and wall (steel on plastic).
        slip_sigma: Standard deviation that sliding adds to a contact, per travel and per angle
            beyond the friction cone in rad (friction known to a third).
        doubt_sigma: Number of standard deviations off the circle beyond which a contact gets less
            weight (this affects one correct contact in 370).
    """

    prior: HoleFitConfig = field(default_factory=HoleFitConfig)
    friction: float = 0.3
    slip_sigma: float = 0.3
    doubt_sigma: float = 3.0


def estimate_hole(
    reading_mm: FloatArray,
    direction: FloatArray,
    start_mm: FloatArray,
    travel: TravelModel,
    config: TouchFitConfig,
) -> Circle:
    """Estimate a hole from the arm's readings at the decisions.

    Args:
        reading_mm: ``(n, 2)`` readings in the plane of the plate, mm.
        direction: ``(n, 2)`` unit directions of the motions.
        start_mm: ``(2,)`` start of the search inside the hole, mm.
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
    doubt = np.ones(len(reading))
    known = travel, config, math.inf, doubt
    circle, normal, sigma = _round(reading, heading, heading, start_mm, known)
    for _ in range(ROUNDS):
        off = np.abs(circle.residual_mm) * doubt / (config.doubt_sigma * sigma)
        doubt = np.maximum(off, 1.0) ** 2
        known = travel, config, max(circle.radius_mm, travel.across_flats_mm), doubt
        circle, normal, sigma = _round(reading, heading, normal, start_mm, known)
    rows = np.column_stack([normal, np.ones(len(normal))])
    gain = circle.covariance_mm2 @ (rows / sigma[:, None] ** 2).T
    angle = np.arctan2(heading[:, 1], heading[:, 0])
    covariance = circle.covariance_mm2 + travel.systematic_mm2(angle, gain)
    return replace(circle, covariance_mm2=covariance)


def _round(
    reading: FloatArray,
    heading: FloatArray,
    normal: FloatArray,
    start_mm: FloatArray,
    known: tuple[TravelModel, TouchFitConfig, float, FloatArray],
) -> tuple[Circle, FloatArray, FloatArray]:
    """Correct the readings along the present normals; return circle, new normals, sigmas.

    ``known`` holds calibration, settings, the hole's radius so far, mm, and the factor ``(n,)`` of
    each contact's standard deviation.
    """
    travel, config, radius_mm, doubt = known
    force, slid = _force(heading, normal, config.friction)
    size = travel.travel_mm(np.arctan2(force[:, 1], force[:, 0]))
    reach = travel.reach_mm(np.arctan2(normal[:, 1], normal[:, 0]), radius_mm)
    center = reading - size[:, None] * force
    sigma = doubt * np.hypot(travel.sigma_mm, config.slip_sigma * np.abs(size) * slid)
    circle = fit_circle(center + reach[:, None] * normal, start_mm, config.prior, sigma)
    away = center - circle.center_mm
    length = np.maximum(np.linalg.norm(away, axis=1), TINY)
    return circle, away / length[:, None], sigma


def _force(
    heading: FloatArray, normal: FloatArray, friction: float
) -> tuple[FloatArray, FloatArray]:
    """Return the force directions ``(n, 2)`` and the angles beyond the cone ``(n,)``, rad."""
    cone = math.atan(friction)
    turn = np.arctan2(
        normal[:, 0] * heading[:, 1] - normal[:, 1] * heading[:, 0], (normal * heading).sum(axis=1)
    )
    kept = np.clip(turn, -cone, cone)
    cos, sin = np.cos(kept), np.sin(kept)
    x, y = normal.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1), np.abs(turn - kept)
