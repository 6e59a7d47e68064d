"""From contact points to a hole: compensation and a circle with its uncertainty (Section V-C).

The tip's centre at the decision lies beyond the first touch by the travel that the detector needs
(delta_crit), and the first touch lies inside the hole by the bit's effective radius (R_offset):
``R_real = R_measured + R_offset - delta_crit``. The published constants, 0.375 and 0.4 mm, nearly
cancel; the bit is hexagonal, touches with its corners and has a mean effective radius of 0.41 mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

HEXAGON_STEP_RAD = math.pi / 3
MOST_DAMPING = 1e9
"""Where the descent gives up: its steps are then a billionth of a Gauss-Newton step."""


def hexagon_reach_mm(across_flats_mm: float, angle_rad: float | Vector) -> Vector:
    """Return how far a hexagon reaches in a direction: its support function, mm.

    Args:
        across_flats_mm: Distance of opposite sides, mm.
        angle_rad: Direction against a corner, rad, any shape.
    """
    folded = np.mod(np.asarray(angle_rad) + HEXAGON_STEP_RAD / 2, HEXAGON_STEP_RAD)
    corner_mm = across_flats_mm / 2 / math.cos(HEXAGON_STEP_RAD / 2)
    return corner_mm * np.cos(folded - HEXAGON_STEP_RAD / 2)


def mean_hexagon_reach_mm(across_flats_mm: float) -> float:
    """Return the mean reach over all headings: 0.4135 mm for 0.75 mm across flats."""
    corner_mm = across_flats_mm / 2 / math.cos(HEXAGON_STEP_RAD / 2)
    return corner_mm * math.sin(HEXAGON_STEP_RAD / 2) / (HEXAGON_STEP_RAD / 2)


@dataclass(frozen=True, kw_only=True)
class Compensation:
    """What lies between the measured tip centre and the wall.

    Attributes:
        offset_mm: R_offset, the bit's effective radius, mm.
        travel_mm: delta_crit, the tip's travel from first touch to decision, mm.
        offset_sigma_mm: Standard deviation of the effective radius from touch to touch, mm: a
            hexagon of unknown heading, 0.75 mm across flats, has 0.0174.
        travel_sigma_mm: Standard deviation of the travel from touch to touch, mm.
    """

    offset_mm: float = mean_hexagon_reach_mm(0.75)
    travel_mm: float = 0.4
    offset_sigma_mm: float = 0.0174
    travel_sigma_mm: float = 0.02

    @classmethod
    def published(cls) -> Compensation:
        """Return the paper's constants: half the bit's width, 0.375 mm, and 0.4 mm."""
        return cls(offset_mm=0.375, travel_mm=0.4, offset_sigma_mm=0.0)

    @property
    def total_mm(self) -> float:
        """What is added to a radius that was measured head-on, mm."""
        return self.offset_mm - self.travel_mm

    @property
    def sigma_mm(self) -> float:
        """Standard deviation of one contact along the radius, mm, without the arm's share."""
        return math.hypot(self.offset_sigma_mm, self.travel_sigma_mm)


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle and the uncertainty of its centre and radius.

    Attributes:
        center_mm: ``(2,)`` centre, mm.
        radius_mm: Radius, mm.
        covariance_mm2: ``(3, 3)`` of (centre x, centre y, radius), mm2.
        residual_mm: ``(n,)`` signed distances of the points from the circle, mm.
    """

    center_mm: Vector
    radius_mm: float
    covariance_mm2: Vector
    residual_mm: Vector

    @property
    def sigma_mm(self) -> Vector:
        """Standard deviations ``(3,)`` of centre x, centre y and radius, mm."""
        return np.sqrt(np.diag(self.covariance_mm2))

    def grown(self, by_mm: float) -> Circle:
        """Return the circle with a larger radius."""
        return replace(self, radius_mm=self.radius_mm + by_mm)


@dataclass(frozen=True, kw_only=True)
class HoleFitConfig:
    """What is known before the contacts, and when the iteration ends.

    Clustered contacts do not tell radius from centre; the prior then does, so that the estimate
    stays in reach and its covariance says how little was learnt.

    Attributes:
        contact_sigma_mm: Standard deviation of one contact along the radius, mm.
        radius_mm: Expected radius of the circle of contacts, mm (middle of 0.7 to 5.0 mm).
        radius_sigma_mm: How uncertain that is, mm.
        center_sigma_mm: How far the centre may lie from where the search began, mm.
        steps: Most Gauss-Newton steps.
        tolerance_mm: Change at which they end, mm.
    """

    contact_sigma_mm: float = 0.03
    radius_mm: float = 2.8
    radius_sigma_mm: float = 2.0
    center_sigma_mm: float = 2.5
    steps: int = 100
    tolerance_mm: float = 1e-10


def fit_circle(
    points_mm: Vector, start_mm: Vector, config: HoleFitConfig, sigma_mm: Vector | None = None
) -> Circle:
    """Fit a circle to points by regularised least squares of the radial distances.

    Levenberg-Marquardt on the sum of squared distances over the contact's variance, plus a
    Gaussian prior on centre and radius; the covariance is the inverse of the information there.
    The search began inside the circle: without that, noise on clustered contacts is read as a
    tiny circle among them. Contacts on one side only bend too little to tell the radius, and a
    circle that is small by chance would state a small error; their covariance is therefore taken
    at the flattest plausible circle through them.

    Args:
        points_mm: ``(n, 2)`` points on the circle, mm; n may be anything from 1.
        start_mm: ``(2,)`` where the search began, inside: the prior's centre, mm.
        config: Contact noise and prior.
        sigma_mm: ``(n,)`` standard deviation of each contact, mm; the config's for all if None.

    Raises:
        ValueError: No points, the wrong shape, or values that are not finite.
    """
    points, start = np.asarray(points_mm, np.float64), np.asarray(start_mm, np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0 or start.shape != (2,):
        raise ValueError(f"got points {points.shape} and start {start.shape}; need (n, 2), (2,)")
    if not (np.isfinite(points).all() and np.isfinite(start).all()):
        raise ValueError("contacts and start must be finite")
    if sigma_mm is None:
        sigma_mm = np.full(len(points), config.contact_sigma_mm)
    problem = _Problem(points, np.append(start, config.radius_mm), config, sigma_mm)
    reach = float(np.linalg.norm(points - start, axis=1).max())
    estimate = problem.descend(np.append(start, reach))
    residual, jacobian = problem.residual(estimate)
    if largest_gap_rad(points, start) > math.pi:
        jacobian = problem.residual(problem.flattest(estimate))[1]
    covariance = np.linalg.inv(problem.information(jacobian))
    return Circle(estimate[:2], float(estimate[2]), covariance.astype(np.float64), residual)


def largest_gap_rad(points_mm: Vector, start_mm: Vector) -> float:
    """Return the largest angle, seen from the start, without a contact: above pi is one-sided."""
    away = points_mm - start_mm
    angle = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    return float(np.diff(angle, append=angle[0] + 2.0 * math.pi).max())


def fit_hole(
    contact_mm: Vector,
    direction: Vector,
    start_mm: Vector,
    compensation: Compensation,
    config: HoleFitConfig,
) -> Circle:
    """Estimate a hole from tip centres at the decisions.

    The travel delta_crit is taken back along each motion, since friction holds the tip where it
    met the wall; the centres at first touch lie on a circle of radius ``R_real - R_offset``. For
    motions through the centre this is the paper's formula.

    Args:
        contact_mm: ``(n, 2)`` tip centres at the decisions, in the plane of the plate, mm.
        direction: ``(n, 2)`` unit directions of the motions.
        start_mm: ``(2,)`` where the search began, inside the hole, mm.
        compensation: R_offset and delta_crit.
        config: Contact noise and prior.

    Returns:
        The hole's circle; residuals are those of the contacts.

    Raises:
        ValueError: As :func:`fit_circle`, or the directions' shape differs from the contacts'.
    """
    contact, heading = np.asarray(contact_mm, np.float64), np.asarray(direction, np.float64)
    if contact.shape != heading.shape:
        raise ValueError(f"got contacts {contact.shape} and directions {heading.shape}; need equal")
    circle = fit_circle(contact - compensation.travel_mm * heading, start_mm, config)
    radius = circle.radius_mm + compensation.offset_mm
    return Circle(circle.center_mm, radius, circle.covariance_mm2, circle.residual_mm)


class _Problem:
    """Least squares of the radial distances, with a Gaussian prior on (x, y, radius)."""

    def __init__(
        self, points: Vector, prior: Vector, config: HoleFitConfig, contact_sigma_mm: Vector
    ) -> None:
        sigma = config.center_sigma_mm, config.center_sigma_mm, config.radius_sigma_mm
        self._points = points
        self._prior = prior
        self._prior_weight = np.array(sigma) ** -2.0
        self._weight = contact_sigma_mm**-2.0
        self._wall_weight = float(self._weight.max())
        self._config = config

    def residual(self, estimate: Vector) -> tuple[Vector, Vector]:
        """Return distances ``(n,)`` from the circle and their Jacobian ``(n, 3)``."""
        offset = self._points - estimate[:2]
        distance = np.maximum(np.linalg.norm(offset, axis=1), np.finfo(float).tiny)
        jacobian = np.column_stack([-offset / distance[:, None], -np.ones(len(offset))])
        return distance - estimate[2], jacobian

    def outside(self, estimate: Vector) -> tuple[Vector, Vector]:
        """Return how far the start lies outside the circle, as residuals and Jacobian rows."""
        offset = self._prior[:2] - estimate[:2]
        distance = float(np.linalg.norm(offset))
        if distance <= estimate[2]:
            return np.empty(0), np.empty((0, 3))
        safe = max(distance, np.finfo(float).tiny)
        return np.array([distance - estimate[2]]), np.array([[*(-offset / safe), -1.0]])

    def flattest(self, estimate: Vector) -> Vector:
        """Return the circle one prior sigma larger than expected, through the same contacts."""
        radius = max(float(estimate[2]), self._config.radius_mm + self._config.radius_sigma_mm)
        if not math.isfinite(radius):
            return estimate
        middle = self._points.mean(axis=0)
        inward = estimate[:2] - middle
        inward = inward / max(float(np.linalg.norm(inward)), np.finfo(float).tiny)
        return np.append(middle + radius * inward, radius)

    def cost(self, estimate: Vector) -> float:
        residual, outside = self.residual(estimate)[0], self.outside(estimate)[0]
        away = estimate - self._prior
        misfit = self._weight @ residual**2 + self._wall_weight * float(outside @ outside)
        return float(misfit + self._prior_weight @ away**2)

    def information(self, jacobian: Vector) -> Vector:
        return (jacobian.T * self._weights(jacobian)) @ jacobian + np.diag(self._prior_weight)

    def _weights(self, jacobian: Vector) -> Vector:
        extra = len(jacobian) - len(self._points)
        return np.append(self._weight, np.full(extra, self._wall_weight))

    def descend(self, estimate: Vector) -> Vector:
        """Return the estimate of least cost, by damped Gauss-Newton steps that never go up."""
        damping, cost = 1e-3, self.cost(estimate)
        for _ in range(self._config.steps):
            rows = zip(self.residual(estimate), self.outside(estimate), strict=True)
            residual, jacobian = (np.concatenate(pair) for pair in rows)
            information = self.information(jacobian)
            pull = self._prior_weight * (estimate - self._prior)
            slope = jacobian.T @ (self._weights(jacobian) * residual) + pull
            damped = information + damping * np.diag(np.diag(information))
            step = np.linalg.solve(damped, -slope)
            trial = self.cost(estimate + step)
            if trial <= cost:
                estimate, cost, damping = estimate + step, trial, damping / 10.0
            else:
                damping *= 10.0
            if damping > MOST_DAMPING or np.abs(step).max() < self._config.tolerance_mm:
                break
        return estimate
