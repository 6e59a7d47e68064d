"""The bit and the trigger travel delta_crit by direction, from touches on a known wall.

The tip's centre at the decision lies beyond the first touch by the travel that the detector needs
(delta_crit). The first touch lies inside the hole by the bit's effective radius (R_offset):
``R_real = R_measured + R_offset - delta_crit``. The published constants, 0.375 and 0.4 mm, nearly
cancel. The bit is hexagonal and touches with its corners; its mean effective radius is 0.41 mm.

The travel depends on the direction: the pads respond sooner to a rod that turns in their plane than
to one that tilts out of it, and stiffness and references differ with the sign. A touch of a flat
wall at a known place yields ``excess = travel - reach``. The travel varies slowly with direction
(harmonics up to the second), the reach of a hexagon six times per turn. Touches in many directions
therefore determine both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spikingtac.types import FloatArray

HEXAGON_STEP_RAD = math.pi / 3  # Angle between neighbouring corners of a hexagon, rad.
CORNER = 0.5 / math.cos(HEXAGON_STEP_RAD / 2)  # Distance of a corner over that of opposite sides.
HEADINGS = 120  # Number of headings that are tried: half a degree apart, 1 um of reach at most.
HARMONICS = 5  # Number of coefficients of a travel: constant, first and second harmonic.

# Least number of directions from which harmonics and heading are fitted: six unknowns, and three
# more.
LEAST_DIRECTIONS = 9

# Least variance of a direction as a fraction of the mean one: it is estimated from few touches.
LEAST_VARIANCE = 0.2
SAME_RAD = 1e-3  # Directions nearer to each other than this count as one, rad.

# Typical error of a fitted heading, rad: the step of the derivative of the reach.
HEADING_ERROR_RAD = math.radians(2.0)


def hexagon_reach_mm(across_flats_mm: float, angle_rad: float | FloatArray) -> FloatArray:
    """Return how far a hexagon reaches in a direction (its support function), mm.

    Args:
        across_flats_mm: Distance of opposite sides, mm.
        angle_rad: Direction relative to a corner, rad, any shape.
    """
    folded = np.mod(np.asarray(angle_rad) + HEXAGON_STEP_RAD / 2, HEXAGON_STEP_RAD)
    return CORNER * across_flats_mm * np.cos(folded - HEXAGON_STEP_RAD / 2)


def _mean_hexagon_reach_mm(across_flats_mm: float) -> float:
    """Return the mean reach over all headings: 0.4135 mm for 0.75 mm across flats."""
    return CORNER * across_flats_mm * math.sin(HEXAGON_STEP_RAD / 2) / (HEXAGON_STEP_RAD / 2)


def hexagon_reach_in_hole_mm(
    across_flats_mm: float, angle_rad: float | FloatArray, radius_mm: float
) -> FloatArray:
    """Return how far a hexagon's centre stays from the wall of a hole, mm.

    The corner next to the direction touches: the centre is then ``sqrt(R^2 - c^2 sin^2) - c cos``
    from the hole's centre, c the distance of a corner. In a wide hole that is the flat wall's
    :func:`hexagon_reach_mm`.

    Args:
        across_flats_mm: Distance of opposite sides, mm.
        angle_rad: Direction from the hole's centre against a corner, rad, any shape.
        radius_mm: Radius of the hole, mm, at least the corner's distance; may be infinite.
    """
    flat = hexagon_reach_mm(across_flats_mm, angle_rad)
    if math.isinf(radius_mm):
        return flat
    across_square = np.maximum((CORNER * across_flats_mm) ** 2 - flat**2, 0.0)
    return radius_mm - np.sqrt(np.maximum(radius_mm**2 - across_square, 0.0)) + flat


# Mean reach of a hexagon of unknown heading, 0.75 mm across flats, and its standard deviation from
# touch to touch, mm.
MEAN_REACH_MM, REACH_SIGMA_MM = _mean_hexagon_reach_mm(0.75), 0.0174


@dataclass(frozen=True, kw_only=True, slots=True)
class TravelModel:
    """The correction of a reading, by direction.

    Attributes:
        harmonics_mm: ``(5,)`` travel: constant, cos, sin, cos of twice, sin of twice the angle, mm.
        covariance_mm2: ``(k, k)`` of them, mm2; with k = 6 the last is the heading, in rad.
        sigma_mm: Standard deviation of one touch about the model, with the arm's error, mm:
            root mean square over the calibrated directions.
        across_flats_mm: Width of the hexagonal bit, mm.
        heading_rad: Direction of one of its corners, rad; None where it is unknown.
        variance_mm2: ``(3,)`` of one touch: constant, cos and sin of twice the angle, mm2; None for
            the same in every direction.
    """

    harmonics_mm: FloatArray
    covariance_mm2: FloatArray
    sigma_mm: float
    across_flats_mm: float = 0.75
    heading_rad: float | None = None
    variance_mm2: FloatArray | None = None

    @classmethod
    def of(cls, travel_mm: float, travel_sigma_mm: float = 0.02) -> TravelModel:
        """Return the same travel for every direction, the bit's heading unknown.

        Args:
            travel_mm: delta_crit, the tip's travel from first touch to decision, mm.
            travel_sigma_mm: Its standard deviation from touch to touch, mm.
        """
        return cls(
            harmonics_mm=travel_mm * np.eye(HARMONICS)[0],
            covariance_mm2=np.zeros((HARMONICS, HARMONICS)),
            sigma_mm=math.hypot(REACH_SIGMA_MM, travel_sigma_mm),
        )

    def travel_mm(self, angle_rad: FloatArray) -> FloatArray:
        """Return the travel ``(n,)`` for force directions ``(n,)``, mm."""
        return _design(angle_rad) @ self.harmonics_mm

    def sigma_at_mm(self, angle_rad: FloatArray) -> FloatArray:
        """Return the standard deviation of one touch by its direction ``(n,)``, mm.

        It is larger for a rod that tilts out of the pads' plane than for one that turns in it.
        """
        if self.variance_mm2 is None:
            return np.full(np.shape(angle_rad), self.sigma_mm)
        found = _twice(angle_rad) @ self.variance_mm2
        return np.sqrt(np.maximum(found, LEAST_VARIANCE * self.sigma_mm**2))

    def reach_mm(self, angle_rad: FloatArray, radius_mm: float) -> FloatArray:
        """Return how far the bit reaches towards the wall of a hole ``(n,)``, mm.

        Args:
            angle_rad: ``(n,)`` directions from the hole's centre.
            radius_mm: Radius of the hole, mm; infinite for a flat wall.
        """
        if self.heading_rad is None:
            whole = np.linspace(0.0, HEXAGON_STEP_RAD, HEADINGS, endpoint=False)
            mean = float(hexagon_reach_in_hole_mm(self.across_flats_mm, whole, radius_mm).mean())
            return np.full(np.shape(angle_rad), mean)
        turned = np.asarray(angle_rad) - self.heading_rad
        return hexagon_reach_in_hole_mm(self.across_flats_mm, turned, radius_mm)

    def systematic_mm2(self, angle_rad: FloatArray, gain: FloatArray) -> FloatArray:
        """Return the covariance ``(k, k)`` that the calibration's own error adds to an estimate.

        Args:
            angle_rad: ``(n,)`` directions of the contacts.
            gain: ``(k, n)`` derivative of the estimate by each contact.
        """
        row = _design(angle_rad)
        if self.heading_rad is not None and len(self.covariance_mm2) > HARMONICS:
            row = _with_heading(angle_rad, self.heading_rad, self.across_flats_mm)
        moved = gain @ row
        return moved @ self.covariance_mm2 @ moved.T


def fit_travel(
    angle_rad: FloatArray, excess_mm: FloatArray, across_flats_mm: float = 0.75
) -> TravelModel:
    """Fit travel and heading to touches on flat walls that face the motion.

    Args:
        angle_rad: ``(n,)`` directions of the touches, rad.
        excess_mm: ``(n,)`` how far beyond the wall the bit's centre was at the decision, mm
            (negative: before it).
        across_flats_mm: Width of the bit, mm.

    Raises:
        ValueError: Shapes differ, fewer than four touches, or a number that is not finite.
    """
    angle, excess = np.asarray(angle_rad, np.float64), np.asarray(excess_mm, np.float64)
    if angle.shape != excess.shape or angle.ndim != 1 or len(angle) < 4:
        raise ValueError(f"got {angle.shape} angles and {excess.shape} touches; need equal, >= 4")
    if not np.isfinite([angle, excess]).all():
        raise ValueError("an angle or an excess is no finite number; leave such touches out")
    if len(np.unique(np.round(angle / SAME_RAD))) < LEAST_DIRECTIONS:
        reach = np.full(len(angle), _mean_hexagon_reach_mm(across_flats_mm))
        return _fit(angle, excess + reach, across_flats_mm, None)
    tried = np.linspace(0.0, HEXAGON_STEP_RAD, HEADINGS, endpoint=False)
    reach = hexagon_reach_mm(across_flats_mm, angle - tried[:, None])
    design = _design(angle)
    left = (excess + reach) @ (np.eye(len(angle)) - design @ np.linalg.pinv(design)).T
    best = int((left**2).sum(axis=1).argmin())
    return _fit(angle, excess + reach[best], across_flats_mm, float(tried[best]))


def _fit(
    angle: FloatArray, travel: FloatArray, across_flats_mm: float, heading: float | None
) -> TravelModel:
    """Fit the harmonics; the residuals give the variance of a touch in each direction."""
    design = _design(angle)
    row = design if heading is None else _with_heading(angle, heading, across_flats_mm)
    harmonics = np.linalg.pinv(design) @ travel
    residual = travel - design @ harmonics
    freedom = max(len(angle) - int(np.linalg.matrix_rank(row)), 1)
    square = residual**2 * (len(angle) / freedom)
    sigma = math.sqrt(float(square.mean()))
    covariance = np.linalg.pinv(row.T @ row, hermitian=True).astype(np.float64) * sigma**2
    return TravelModel(
        harmonics_mm=harmonics,
        covariance_mm2=covariance,
        sigma_mm=sigma,
        across_flats_mm=across_flats_mm,
        heading_rad=heading,
        variance_mm2=np.linalg.pinv(_twice(angle)) @ square,
    )


def _design(angle_rad: FloatArray) -> FloatArray:
    angle = np.asarray(angle_rad, np.float64)
    columns = [np.ones_like(angle), np.cos(angle), np.sin(angle)]
    return np.stack([*columns, np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=-1)


def _twice(angle_rad: FloatArray) -> FloatArray:
    twice = 2.0 * np.asarray(angle_rad, np.float64)
    return np.stack([np.ones_like(twice), np.cos(twice), np.sin(twice)], axis=-1)


def _with_heading(angle_rad: FloatArray, heading_rad: float, across_flats_mm: float) -> FloatArray:
    """Return the derivatives of an excess by harmonics and heading ``(n, 6)``."""
    turned = np.asarray(angle_rad, np.float64) - heading_rad
    ahead = hexagon_reach_mm(across_flats_mm, turned + HEADING_ERROR_RAD)
    behind = hexagon_reach_mm(across_flats_mm, turned - HEADING_ERROR_RAD)
    slope = (ahead - behind) / (2.0 * HEADING_ERROR_RAD)
    return np.concatenate([_design(angle_rad), slope[..., None]], axis=-1)
