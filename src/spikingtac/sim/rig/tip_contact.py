"""Contact of a rigid tip on a compliant mount: unilateral, with Coulomb friction.

The tip's points must not enter the wall; where one presses, friction holds it at the place where it
touched first, until the tangential force exceeds the cone. Solved by Gauss-Seidel over the points
(:mod:`spikingtac.sim.rig.tip_contact_kernels`), each of which is solved exactly (stick) or by a
short fixed-point iteration on the direction (slip). Any :class:`~spikingtac.sim.rig.walls.Wall`
will do: it is asked for distances, normals and their turn, never for its kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.rig.tip_contact_kernels import (
    Facing,
    Mount,
    TipPoints,
    inverse_kernel,
    press_kernel,
    remember_kernel,
)
from spikingtac.sim.rig.walls import Bit, Wall

Vector = NDArray[np.float64]

NEWTON_STEPS = 30
"""Most times the wall is linearised anew; a step of the rig needs two or three."""
PLAIN_STEPS = 8
"""After so many the tip moves only half as far: two corners may take turns in holding it."""
TURN_RAD = 1e-5
"""Turn of a wall's normal at which that ends: less than 1e-5 of the force."""


@dataclass
class TipContact:
    """The tip's touching points, their forces and where each of them sticks.

    Args:
        bit: The shape of the tip.
        wall: What it can touch.
        friction: Coulomb coefficient between bit and wall.

    Attributes:
        force_n: ``(n, 3)`` force of the wall on each of the bit's points, N.
        free_gap_mm: Least distance to the wall of the last free tip, mm.
    """

    bit: Bit
    wall: Wall
    friction: float

    def __post_init__(self) -> None:
        self._points_mm = self.bit.points_mm
        count = len(self._points_mm)
        self.force_n = np.zeros((count, 3))
        self.free_gap_mm = np.inf
        self._corners = TipPoints(self.force_n, np.zeros((count, 3)), np.zeros(count, np.bool_))
        self._pressed = False

    def gap_mm(self, tip_mm: Vector) -> float:
        """Return the least distance of the tip to the wall, mm."""
        gap, _ = self.wall.gap(tip_mm + self._points_mm)
        return float(gap.min()) - self.bit.radius_mm

    def solve(self, free_mm: Vector, compliance: Vector) -> Vector:
        """Return the total force ``(3,)`` on the tip, N, and remember what sticks.

        Args:
            free_mm: ``(3,)`` where the tip would be without contact, mm.
            compliance: ``(3, 3)`` tip displacement per force, mm/N.
        """
        self.free_gap_mm = self.gap_mm(free_mm)
        if self.free_gap_mm >= 0.0:
            if self._pressed:
                self.force_n[:], self._corners.stuck[:], self._pressed = 0.0, False, False
            return np.zeros(3)
        mount = Mount(free_mm, compliance, inverse_kernel(compliance))
        tip = free_mm + compliance @ self.force_n.sum(axis=0)
        normal = np.zeros_like(self._points_mm)
        for step in range(NEWTON_STEPS):
            points_mm = tip + self._points_mm
            gap, seen = self.wall.gap(points_mm)
            if np.abs(seen - normal).max() < TURN_RAD:
                break
            normal = seen
            facing = Facing(gap - self.bit.radius_mm, normal, self.wall.bend(points_mm))
            share = 1.0 if step < PLAIN_STEPS else 0.5
            press_kernel(self._corners, facing, mount, self.friction, tip, share)
        remember_kernel(self._corners, normal, self.friction, tip)
        self._pressed = True
        return self.force_n.sum(axis=0)
