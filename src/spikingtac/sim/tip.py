"""Contact of a rigid tip on a compliant mount: unilateral, with Coulomb friction.

The tip's points must not enter the wall; where one presses, friction holds it at the place where it
touched first, until the tangential force exceeds the cone. Solved by Gauss-Seidel over the points,
each of which is solved exactly (stick) or by a short fixed-point iteration on the direction (slip).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.walls import Bit, Wall

Vector = NDArray[np.float64]

NEWTON_STEPS = 30
"""Most times the wall is linearised anew; a step of the rig needs two or three."""
PLAIN_STEPS = 8
"""After so many the tip moves only half as far: two corners may take turns in holding it."""
TURN_RAD = 1e-5
"""Turn of a wall's normal at which that ends: less than 1e-5 of the force."""
SWEEPS = 30
"""Most Gauss-Seidel sweeps; two points of a hexagon need about ten."""
SLIP_STEPS = 12
"""Most fixed-point steps for the direction of slip; the error falls by about 3 with each."""
TOLERANCE_N = 1e-8
"""Change of force at which the sweeps end, N (a millionth of the force at 1 mm of travel)."""


@dataclass
class TipContact:
    """The tip's touching points, their forces and where each of them sticks.

    Args:
        bit: The shape of the tip.
        wall: What it can touch.
        friction: Coulomb coefficient between bit and wall.
    """

    bit: Bit
    wall: Wall
    friction: float

    def __post_init__(self) -> None:
        count = len(self.bit.points_mm)
        self.force_n = np.zeros((count, 3))
        self._anchor_mm = np.zeros((count, 3))
        self._stuck = np.zeros(count, bool)
        self._pressed = False

    def gap_mm(self, tip_mm: Vector) -> float:
        """Return the least distance of the tip to the wall, mm."""
        gap, _ = self.wall.gap(tip_mm + self.bit.points_mm)
        return float(gap.min()) - self.bit.radius_mm

    def solve(self, free_mm: Vector, compliance: Vector) -> Vector:
        """Return the total force ``(3,)`` on the tip, N, and remember what sticks.

        Args:
            free_mm: ``(3,)`` where the tip would be without contact, mm.
            compliance: ``(3, 3)`` tip displacement per force, mm/N.
        """
        if self.gap_mm(free_mm) >= 0.0:
            if self._pressed:
                self.force_n[:], self._stuck[:], self._pressed = 0.0, False, False
            return np.zeros(3)
        points = self.bit.points_mm
        stiffness = np.linalg.inv(compliance).astype(np.float64)
        tip = free_mm + compliance @ self.force_n.sum(axis=0)
        normal = np.zeros_like(points)
        for step in range(NEWTON_STEPS):
            gap, seen = self.wall.gap(tip + points)
            if np.abs(seen - normal).max() < TURN_RAD:
                break
            normal = seen
            pressure = np.maximum((self.force_n * normal).sum(axis=1), 0.0)
            bend = np.tensordot(pressure, self.wall.bend(tip + points), axes=1)
            mount = _Mount.bent(free_mm, stiffness, bend, tip)
            reach = (normal * tip).sum(axis=1) - (gap - self.bit.radius_mm)
            self._sweep(mount, normal, reach)
            share = 1.0 if step < PLAIN_STEPS else 0.5
            tip = tip + share * (mount.tip(self.force_n.sum(axis=0)) - tip)
        self._remember(tip, normal)
        return self.force_n.sum(axis=0)

    def _sweep(self, mount: _Mount, normal: Vector, reach: Vector) -> None:
        """Relax the points in turn; ``normal @ tip >= reach`` is what each of them demands."""
        for _ in range(SWEEPS):
            change = 0.0
            for k in range(len(normal)):
                others = mount.tip(self.force_n.sum(axis=0) - self.force_n[k])
                depth = float(reach[k] - normal[k] @ others)
                force = np.zeros(3)
                if depth > 0.0:
                    anchor = self._anchor_mm[k] if self._stuck[k] else others
                    anchor = anchor + normal[k] * (reach[k] - normal[k] @ anchor)
                    force = mount.hold(others, normal[k], anchor, self.friction)
                change = max(change, float(np.abs(force - self.force_n[k]).max()))
                self.force_n[k] = force
            if change < TOLERANCE_N or len(normal) == 1:
                break

    def _remember(self, tip: Vector, normal: Vector) -> None:
        """Keep the anchor of what stuck; move it along with what slipped or has just touched."""
        pressure = (self.force_n * normal).sum(axis=1)
        pressed = pressure > 0.0
        tangential = np.linalg.norm(self.force_n - pressure[:, None] * normal, axis=1)
        slipped = tangential > self.friction * pressure * (1.0 - 1e-6)
        self._anchor_mm[pressed & (slipped | ~self._stuck)] = tip
        self._stuck, self._pressed = pressed, True


@dataclass(frozen=True)
class _Mount:
    """The compliant mount of the tip: where it is free, and how it yields."""

    free_mm: Vector
    compliance: Vector
    stiffness: Vector

    @classmethod
    def bent(cls, free_mm: Vector, stiffness: Vector, bend: Vector, at_mm: Vector) -> _Mount:
        """Return the mount as seen along a bent wall.

        A pressure turns with the normal as the tip slides; to first order that is a spring around
        the present tip, without which a hole narrower than the tip's travel is never solved.

        Args:
            free_mm: ``(3,)`` where the tip would be without contact, mm.
            stiffness: ``(3, 3)`` of the mount, N/mm.
            bend: ``(3, 3)`` pressure times the turn of the normal, N/mm.
            at_mm: ``(3,)`` present tip, mm.
        """
        stiff = stiffness + bend
        compliance = np.linalg.inv(stiff).astype(np.float64)
        return cls(compliance @ (stiffness @ free_mm + bend @ at_mm), compliance, stiff)

    def tip(self, force_n: Vector) -> Vector:
        return self.free_mm + self.compliance @ force_n

    def hold(self, free: Vector, normal: Vector, anchor: Vector, friction: float) -> Vector:
        """Return the force that keeps a point from ``free`` at its anchor, or lets it slip."""
        stick = self.stiffness @ (anchor - free)
        pressure = float(stick @ normal)
        tangential = stick - pressure * normal
        size = float(np.linalg.norm(tangential))
        if pressure > 0.0 and size <= friction * pressure:
            return stick
        depth = float(normal @ (anchor - free))
        direction, force = tangential / size, np.zeros(3)
        for _ in range(SLIP_STEPS):
            cone = normal + friction * direction
            before, yielding = force, float(normal @ self.compliance @ cone)
            if yielding <= 0.0:  # the tip jams: no slip can undo the penetration (Painleve)
                return stick
            force = cone * (depth / yielding)
            slide = free + self.compliance @ force - anchor
            slide = slide - float(slide @ normal) * normal
            length = float(np.linalg.norm(slide))
            if length > 0.0:
                direction = -slide / length
            if np.abs(force - before).max() < TOLERANCE_N:
                break
        return force
