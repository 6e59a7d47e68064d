"""From readings of touches to a circle with its uncertainty (Section V-C).

A motion that meets the wall head-on has the calibrated travel along its direction. A motion at an
angle beyond the friction cone slides: the rod bends along the edge of the cone, and the tip moves
along the wall. The travel is therefore subtracted along the force. Incidence and the hexagon's
reach depend on the hole, so the fit is repeated a few times. Contacts far off the circle get less
weight, since one in a thousand is false.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from spikingtac.geometry.travel import TravelModel
from spikingtac.types import FloatArray, one_line

# The Gaussian prior. Clustered contacts do not determine radius and centre separately: the prior
# keeps the estimate in reach, and the covariance states how little the contacts contribute.
PRIOR_RADIUS_MM = 2.8  # Expected radius of the circle of contacts, mm (middle of 0.7 to 5.0 mm).
PRIOR_SIGMA_MM = (2.5, 2.5, 2.0)  # Standard deviations of centre x, centre y and radius, mm.
FRICTION = 0.3  # Coulomb coefficient between bit and wall (steel on plastic).

# Standard deviation that sliding adds to a contact, per travel and per angle beyond the friction
# cone in rad (friction known to a third).
SLIP_SIGMA = 0.3

# Number of standard deviations off the circle beyond which a contact gets less weight (this affects
# one correct contact in 370).
DOUBT_SIGMA = 3.0
ROUNDS = 4  # Number of repeated fits: the third one changes the estimate by less than a micrometre.
TOLERANCE = 1e-12  # Relative change of the circle at which the fit ends (below a nanometre).

# Relative change of the cost at which it ends: the cost is flat at its minimum.
COST_TOLERANCE = 1e-15
TINY = float(np.finfo(np.float64).tiny)  # Smallest divisor: a point may lie at the centre.


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


def fit_circle(points_mm: FloatArray, start_mm: FloatArray, sigma_mm: FloatArray | float) -> Circle:
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
    expected, prior_scale = np.append(start, PRIOR_RADIUS_MM), 1.0 / np.array(PRIOR_SIGMA_MM)

    def distances(circle: FloatArray) -> FloatArray:
        return np.linalg.norm(points - circle[:2], axis=1) - circle[2]

    def residuals(circle: FloatArray) -> FloatArray:
        """Return the scaled residuals: contacts, start outside the circle, prior."""
        outside = float(np.linalg.norm(start - circle[:2])) - circle[2]
        inside = [float(scale.max()) * max(outside, 0.0)]
        scaled = scale * distances(circle), inside, prior_scale * (circle - expected)
        return np.concatenate(scaled)

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
    one_sided = _largest_gap_rad(points, start) > math.pi
    if one_sided:  # the circle through the same contacts that has at least a radius of the prior
        radius = max(float(estimate[2]), PRIOR_RADIUS_MM + PRIOR_SIGMA_MM[2])
        middle = points.mean(axis=0)
        inward = estimate[:2] - middle
        inward = inward / max(float(np.linalg.norm(inward)), TINY)
        known = np.append(middle + radius * inward, radius)
    rows = scale[:, None] * _gradient(points - known[:2])
    covariance = np.linalg.inv(rows.T @ rows + np.diag(prior_scale**2)).astype(np.float64)
    return Circle(estimate[:2], float(estimate[2]), covariance, distances(estimate))


def _largest_gap_rad(points_mm: FloatArray, start_mm: FloatArray) -> float:
    """Return the largest angle without a contact, seen from the start; above pi is one-sided."""
    away = points_mm - start_mm
    angle = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    return float(np.diff(angle, append=angle[0] + 2.0 * math.pi).max())


def _gradient(offset: FloatArray) -> FloatArray:
    """Return how the distances of points at some offsets ``(n, 2)`` follow (x, y, radius)."""
    length = np.maximum(np.linalg.norm(offset, axis=1), TINY)
    return np.column_stack([-offset / length[:, None], -np.ones(len(offset))])


def estimate_hole(
    reading_mm: FloatArray, direction: FloatArray, start_mm: FloatArray, travel: TravelModel
) -> Circle:
    """Estimate a hole from the arm's readings at the decisions.

    Args:
        reading_mm: ``(n, 2)`` readings in the plane of the plate, mm.
        direction: ``(n, 2)`` unit directions of the motions.
        start_mm: ``(2,)`` start of the search inside the hole, mm.
        travel: The calibration.

    Returns:
        Hole, with the covariance of contacts and calibration; residuals are those of the contacts.

    Raises:
        ValueError: As :func:`fit_circle`, or the shapes differ.
    """
    reading, heading = np.asarray(reading_mm, np.float64), np.asarray(direction, np.float64)
    if reading.shape != heading.shape:
        raise ValueError(f"got readings {reading.shape} and directions {heading.shape}; need equal")
    normal, doubt, radius_mm, rounds = heading, np.ones(len(reading)), math.inf, 0
    while True:
        # Each reading less the travel along its force is the tip's centre at the first touch.
        force, slid = _force(heading, normal)
        size = travel.travel_mm(np.arctan2(force[:, 1], force[:, 0]))
        reach = travel.reach_mm(np.arctan2(normal[:, 1], normal[:, 0]), radius_mm)
        center = reading - size[:, None] * force
        sigma = doubt * np.hypot(travel.sigma_mm, SLIP_SIGMA * np.abs(size) * slid)
        circle = fit_circle(center + reach[:, None] * normal, start_mm, sigma)
        away = center - circle.center_mm
        normal = away / np.maximum(np.linalg.norm(away, axis=1), TINY)[:, None]
        if rounds == ROUNDS:
            break
        excess = np.abs(circle.residual_mm) * doubt / (DOUBT_SIGMA * sigma)
        doubt = np.maximum(excess, 1.0) ** 2
        radius_mm = max(circle.radius_mm, travel.across_flats_mm)
        rounds += 1
    rows = np.column_stack([normal, np.ones(len(normal))])
    gain = circle.covariance_mm2 @ (rows / sigma[:, None] ** 2).T
    angle = np.arctan2(heading[:, 1], heading[:, 0])
    covariance = circle.covariance_mm2 + travel.systematic_mm2(angle, gain)
    return replace(circle, covariance_mm2=covariance)


def _force(heading: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the force directions ``(n, 2)`` and the angles beyond the cone ``(n,)``, rad."""
    (x, y), (along_x, along_y) = normal.T, heading.T
    turn = np.arctan2(x * along_y - y * along_x, (normal * heading).sum(axis=1))
    kept = np.clip(turn, -math.atan(FRICTION), math.atan(FRICTION))
    cos, sin = np.cos(kept), np.sin(kept)
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1), np.abs(turn - kept)
