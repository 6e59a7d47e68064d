"""From contact points to a circle with its uncertainty, and the geometry of the bit (Section V-C).

The tip's centre at the decision lies beyond the first touch by the travel that the detector needs
(delta_crit). The first touch lies inside the hole by the bit's effective radius (R_offset):
``R_real = R_measured + R_offset - delta_crit``. The published constants, 0.375 and 0.4 mm, nearly
cancel. The bit is hexagonal and touches with its corners; its mean effective radius is 0.41 mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from spikingtac.arrays import one_line
from spikingtac.types import FloatArray

HEXAGON_STEP_RAD = math.pi / 3  # Angle between neighbouring corners of a hexagon, rad.
TOLERANCE = 1e-12  # Relative change of the circle at which the fit ends (below a nanometre).

# Relative change of the cost at which it ends: the cost is flat at its minimum.
COST_TOLERANCE = 1e-15
TINY = float(np.finfo(np.float64).tiny)  # Smallest divisor: a point may lie at the centre.


def hexagon_reach_mm(across_flats_mm: float, angle_rad: float | FloatArray) -> FloatArray:
    """Return how far a hexagon reaches in a direction (its support function), mm.

    Args:
        across_flats_mm: Distance of opposite sides, mm.
        angle_rad: Direction relative to a corner, rad, any shape.
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
    """The distance between the measured tip centre and the wall.

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
        """Correction of a radius that was measured head-on, mm."""
        return self.offset_mm - self.travel_mm

    @property
    def sigma_mm(self) -> float:
        """Standard deviation of one contact along the radius, mm, without the arm's error."""
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

    center_mm: FloatArray
    radius_mm: float
    covariance_mm2: FloatArray
    residual_mm: FloatArray

    __repr__ = one_line

    @property
    def sigma_mm(self) -> FloatArray:
        """Standard deviations ``(3,)`` of centre x, centre y and radius, mm."""
        return np.sqrt(np.diag(self.covariance_mm2))

    def grown(self, by_mm: float) -> Circle:
        """Return the circle with a larger radius."""
        return replace(self, radius_mm=self.radius_mm + by_mm)


@dataclass(frozen=True, kw_only=True)
class HoleFitConfig:
    """The Gaussian prior of centre and radius.

    Clustered contacts do not determine radius and centre separately. The prior then keeps the
    estimate in reach, and the covariance states how little the contacts contribute.

    Attributes:
        radius_mm: Expected radius of the circle of contacts, mm (middle of 0.7 to 5.0 mm).
        radius_sigma_mm: Standard deviation of this radius, mm.
        center_sigma_mm: Standard deviation of the centre about the search's start, per axis, mm.
    """

    radius_mm: float = 2.8
    radius_sigma_mm: float = 2.0
    center_sigma_mm: float = 2.5


def fit_circle(
    points_mm: FloatArray, start_mm: FloatArray, config: HoleFitConfig, sigma_mm: FloatArray | float
) -> Circle:
    """Fit a circle to points by regularised least squares of the radial distances.

    Levenberg-Marquardt minimises the squared distances over the contacts' variances plus the
    Gaussian prior; the covariance is the inverse of the information at the minimum. The search
    began inside the circle: without this constraint, the noise of clustered contacts is taken for
    a tiny circle among them. Contacts on one side bend too little to determine the radius, and a
    circle that is small by chance would state a small error. Their covariance is therefore that of
    the flattest plausible circle through them.

    Args:
        points_mm: ``(n, 2)`` points on the circle, mm; n is 1 or more.
        start_mm: ``(2,)`` start of the search inside the circle: the prior's centre, mm.
        config: The prior.
        sigma_mm: Standard deviation of each contact along the radius ``(n,)``, or of all, mm.

    Raises:
        ValueError: There are no points, the shapes are wrong, or values are not finite.
    """
    points, start = np.asarray(points_mm, np.float64), np.asarray(start_mm, np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0 or start.shape != (2,):
        raise ValueError(f"got points {points.shape} and start {start.shape}; need (n, 2), (2,)")
    if not (np.isfinite(points).all() and np.isfinite(start).all()):
        raise ValueError("contacts and start must be finite")
    scale = 1.0 / np.broadcast_to(np.asarray(sigma_mm, np.float64), (len(points),))
    sigmas = config.center_sigma_mm, config.center_sigma_mm, config.radius_sigma_mm
    expected, prior_scale = np.append(start, config.radius_mm), 1.0 / np.array(sigmas)

    def distances(circle: FloatArray) -> FloatArray:
        return np.linalg.norm(points - circle[:2], axis=1) - circle[2]

    def residuals(circle: FloatArray) -> FloatArray:
        """Return the scaled residuals: contacts, start outside the circle, prior."""
        outside = float(np.linalg.norm(start - circle[:2])) - circle[2]
        inside = [float(scale.max()) * max(outside, 0.0)]
        return np.concatenate(
            [scale * distances(circle), inside, prior_scale * (circle - expected)]
        )

    def jacobian(circle: FloatArray) -> FloatArray:
        offset = (start - circle[:2])[None, :]
        outside = float(np.linalg.norm(offset)) > circle[2]
        inside = (float(scale.max()) if outside else 0.0) * _gradient(offset)
        contacts = scale[:, None] * _gradient(points - circle[:2])
        return np.concatenate([contacts, inside, np.diag(prior_scale)])

    first = np.append(start, np.linalg.norm(points - start, axis=1).max())
    limits = {"xtol": TOLERANCE, "ftol": COST_TOLERANCE}
    found = least_squares(residuals, first, jacobian, method="lm", **limits)  # pyright: ignore[reportArgumentType]
    estimate = known = np.asarray(found.x, np.float64)
    one_sided = largest_gap_rad(points, start) > math.pi
    if one_sided:
        known = _flattest(points, estimate, config.radius_mm + config.radius_sigma_mm)
    rows = scale[:, None] * _gradient(points - known[:2])
    covariance = np.linalg.inv(rows.T @ rows + np.diag(prior_scale**2)).astype(np.float64)
    return Circle(estimate[:2], float(estimate[2]), covariance, distances(estimate))


def largest_gap_rad(points_mm: FloatArray, start_mm: FloatArray) -> float:
    """Return the largest angle without a contact, seen from the start; above pi is one-sided."""
    away = points_mm - start_mm
    angle = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    return float(np.diff(angle, append=angle[0] + 2.0 * math.pi).max())


def _flattest(points: FloatArray, estimate: FloatArray, radius_mm: float) -> FloatArray:
    """Return the circle through the same contacts that has at least this radius."""
    radius = max(float(estimate[2]), radius_mm)
    if not math.isfinite(radius):
        return estimate
    middle = points.mean(axis=0)
    inward = estimate[:2] - middle
    inward = inward / max(float(np.linalg.norm(inward)), TINY)
    return np.append(middle + radius * inward, radius)


def _gradient(offset: FloatArray) -> FloatArray:
    """Return how the distances of points at some offsets ``(n, 2)`` follow (x, y, radius)."""
    length = np.maximum(np.linalg.norm(offset, axis=1), TINY)
    return np.column_stack([-offset / length[:, None], -np.ones(len(offset))])
