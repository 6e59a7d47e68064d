"""Walls and bits, and the contact of the tip with a wall.

Contact means that a distance must not become negative. The frame is the robot's base (mm), in which
the probe stands vertically and z points up.

The mount of the tip is compliant; contact is unilateral, with Coulomb friction. The points of the
tip must not enter the wall. Friction holds a pressing point at the place of its first touch until
the tangential force exceeds the friction cone. The problem is solved by Gauss-Seidel sweeps over
the points (:mod:`spikingtac.sim.rig.tip_contact`). Each point is solved exactly (stick) or by a
short fixed-point iteration on the direction (slip). Any :class:`Wall` can be used: it gives
distances, normals and curvature.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from spikingtac.sim.rig.tip_contact import (
    CompliantMount,
    LinearisedWall,
    TipPoints,
    inverse_kernel,
    solve_linearised_kernel,
    update_anchors_kernel,
)
from spikingtac.types import FloatArray

HEXAGON_CORNERS = 6

# Smallest distance from an axis, so that a point on it has a direction.
_TINY = float(np.finfo(np.float64).tiny)


class NoWall:
    """Free air: no wall, and no curvature."""

    def gap(self, point_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distance ``(n,)`` to the surface and its outward normal ``(n, 3)``.

        Args:
            point_mm: ``(n, 3)`` points in the base frame, mm; a negative gap is a penetration.
        """
        return np.full(len(point_mm), np.inf), np.zeros((len(point_mm), 3))

    def curvature(self, point_mm: FloatArray) -> FloatArray:
        """Return the curvature tensors ``(n, 3, 3)``, 1/mm: minus the derivative of the normal."""
        return np.zeros((len(point_mm), 3, 3))


class PlaneWall(NoWall):
    """A flat wall.

    Args:
        point_mm: Any point of the wall, mm.
        normal: Direction away from the wall, into the free side (normalised here).
    """

    def __init__(self, point_mm: ArrayLike, normal: ArrayLike = (-1.0, 0.0, 0.0)) -> None:
        self._point_mm, self._normal = np.array(point_mm, np.float64), _unit(normal)

    def gap(self, point_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distance and normal."""
        normal = np.empty(point_mm.shape)
        normal[:] = self._normal
        return (point_mm - self._point_mm) @ self._normal, normal


class HoleWall:
    """The inner wall of a round hole, so deep that the bit meets only its side.

    Args:
        radius_mm: Radius of the hole, mm.
        center_mm: A point on the hole's axis, mm.
        axis: Direction of the axis. A tilted axis is a tilted plate.
    """

    def __init__(
        self, radius_mm: float, center_mm: ArrayLike = (0, 0, 0), axis: ArrayLike = (0, 0, 1)
    ) -> None:
        if radius_mm <= 0:
            raise ValueError(f"radius_mm is {radius_mm}, a hole needs a positive radius")
        self.radius_mm = radius_mm
        self._center_mm, self._axis = np.array(center_mm, np.float64), _unit(axis)

    def gap(self, point_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distance and normal (towards the axis)."""
        offset, axis = point_mm - self._center_mm, self._axis
        radial = offset - (offset @ axis)[:, None] * axis
        distance = np.maximum(np.sqrt((radial * radial).sum(axis=1)), _TINY)
        return self.radius_mm - distance, -radial / distance[:, None]

    def curvature(self, point_mm: FloatArray) -> FloatArray:
        """Return the curvature around the hole, 1 / distance from the axis."""
        gap, inward = self.gap(point_mm)
        around = np.cross(self._axis, inward)
        return around[:, :, None] * around[:, None, :] / (self.radius_mm - gap)[:, None, None]


Wall = NoWall | PlaneWall | HoleWall  # A rigid surface. All points must stay on its free side.


# Diameter of the bit, or distance of opposite sides, mm (the paper's Section V-C).
BIT_ACROSS_MM = 0.75


@dataclass(frozen=True, kw_only=True)
class Bit:
    """The end of the probe, a round or a hexagonal bit: balls of one radius around a few points.

    Attributes:
        heading_rad: Direction of one corner of a hexagon in the base's xy-plane, rad; None for a
            round bit. Its corners meet a concave wall; a corner or a side meets a flat one.
    """

    heading_rad: float | None = None

    @property
    def radius_mm(self) -> float:
        """Radius around each point, mm: the paper's R_offset of a round bit, 0 of a corner."""
        return BIT_ACROSS_MM / 2 if self.heading_rad is None else 0.0

    @property
    def points_mm(self) -> FloatArray:
        """Offsets ``(n, 3)`` of the touching points from the tip's centre, base frame, mm."""
        if self.heading_rad is None:
            return np.zeros((1, 3))
        angle = self.heading_rad + np.arange(HEXAGON_CORNERS) * (2 * np.pi / HEXAGON_CORNERS)
        corner_mm = BIT_ACROSS_MM / 2 / np.cos(np.pi / HEXAGON_CORNERS)
        return corner_mm * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])


def _unit(direction: ArrayLike) -> FloatArray:
    vector = np.asarray(direction, np.float64)
    length = np.linalg.norm(vector)
    if not length > 0:
        raise ValueError(f"the direction {direction} has no length")
    return vector / length


# Largest number of linearisations of the wall; a step of the rig needs two or three.
NEWTON_STEPS = 30

# Number of full steps. Later steps go half the way: two points may alternate in contact.
FULL_STEPS = 8

# Turn of the wall's normal at which the iteration ends; it changes the force by less than 1e-5.
MAX_TURN_RAD = 1e-5


class TipContact:
    """The touching points of the tip, their forces, and the place at which each of them sticks.

    Args:
        bit: Shape of the tip.
        wall: The wall that it can touch.
        friction: Coefficient of friction between bit and wall.

    Attributes:
        force_n: ``(n, 3)`` force of the wall on each of the bit's points, N.
        free_gap_mm: Smallest distance from the wall of the last unloaded tip, mm.
    """

    def __init__(self, bit: Bit, wall: Wall, friction: float) -> None:
        self.wall, self._friction, self._offsets_mm = wall, friction, bit.points_mm
        self._radius_mm = bit.radius_mm
        count = len(self._offsets_mm)
        self.force_n = np.zeros((count, 3))
        self.free_gap_mm = np.inf
        self._points = TipPoints(self.force_n, np.zeros((count, 3)), np.zeros(count, np.bool_))
        self._pressed = False

    def gap_mm(self, tip_mm: FloatArray) -> float:
        """Return the smallest distance of the tip from the wall, mm."""
        gap, _ = self.wall.gap(tip_mm + self._offsets_mm)
        return float(gap.min()) - self._radius_mm

    def solve(self, free_mm: FloatArray, compliance: FloatArray) -> FloatArray:
        """Return the total force ``(3,)`` on the tip, N, and store what sticks.

        Args:
            free_mm: ``(3,)`` position of the tip without contact, mm.
            compliance: ``(3, 3)`` tip displacement per force, mm/N.
        """
        self.free_gap_mm = self.gap_mm(free_mm)
        if self.free_gap_mm >= 0.0:
            if self._pressed:
                self.force_n[:], self._points.stuck[:], self._pressed = 0.0, False, False
            return np.zeros(3)
        mount = CompliantMount(free_mm, compliance, inverse_kernel(compliance))
        tip = free_mm + compliance @ self.force_n.sum(axis=0)
        normal = np.zeros_like(self._offsets_mm)
        for step in range(NEWTON_STEPS):
            points_mm = tip + self._offsets_mm
            gap, seen = self.wall.gap(points_mm)
            if np.abs(seen - normal).max() < MAX_TURN_RAD:
                break
            normal = seen
            wall = LinearisedWall(gap - self._radius_mm, normal, self.wall.curvature(points_mm))
            fraction = 1.0 if step < FULL_STEPS else 0.5
            solve_linearised_kernel(self._points, wall, mount, self._friction, tip, fraction)
        update_anchors_kernel(self._points, normal, self._friction, tip)
        self._pressed = True
        return self.force_n.sum(axis=0)
