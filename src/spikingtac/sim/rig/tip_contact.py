"""Contact of a rigid tip on a compliant mount: unilateral, with Coulomb friction.

The points of the tip must not enter the wall. Friction holds a pressing point at the place of its
first touch until the tangential force exceeds the friction cone. The problem is solved by
Gauss-Seidel sweeps over the points (:mod:`spikingtac.sim.rig.tip_contact_kernels`). Each point is
solved exactly (stick) or by a short fixed-point iteration on the direction (slip). Any
:class:`~spikingtac.sim.rig.walls.Wall` can be used: it gives distances, normals and curvature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac.sim.rig.tip_contact_kernels import (
    CompliantMount,
    LinearisedWall,
    TipPoints,
    inverse_kernel,
    solve_linearised_kernel,
    update_anchors_kernel,
)
from spikingtac.sim.rig.walls import Bit, Wall

NEWTON_STEPS = 30
"""Largest number of linearisations of the wall; a step of the rig needs two or three."""
FULL_STEPS = 8
"""Number of full steps. Later steps go half the way: two points may alternate in contact."""
MAX_TURN_RAD = 1e-5
"""Turn of the wall's normal at which the iteration ends; it changes the force by less than 1e-5."""


@dataclass
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

    bit: Bit
    wall: Wall
    friction: float

    def __post_init__(self) -> None:
        self._offsets_mm = self.bit.points_mm
        count = len(self._offsets_mm)
        self.force_n = np.zeros((count, 3))
        self.free_gap_mm = np.inf
        self._points = TipPoints(self.force_n, np.zeros((count, 3)), np.zeros(count, np.bool_))
        self._pressed = False

    def gap_mm(self, tip_mm: FloatArray) -> float:
        """Return the smallest distance of the tip from the wall, mm."""
        gap, _ = self.wall.gap(tip_mm + self._offsets_mm)
        return float(gap.min()) - self.bit.radius_mm

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
            wall = LinearisedWall(gap - self.bit.radius_mm, normal, self.wall.curvature(points_mm))
            fraction = 1.0 if step < FULL_STEPS else 0.5
            solve_linearised_kernel(self._points, wall, mount, self.friction, tip, fraction)
        update_anchors_kernel(self._points, normal, self.friction, tip)
        self._pressed = True
        return self.force_n.sum(axis=0)
