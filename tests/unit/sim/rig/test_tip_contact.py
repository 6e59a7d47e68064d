"""Contact at the tip obeys its laws on random mounts, walls and paths."""

import numpy as np
import pytest

from spikingtac.sim.rig.walls import Bit, HexBit, HoleWall, PlaneWall, RoundBit, TipContact, Wall

TOLERANCE_MM = 1e-4
HANDOVER_MM = 5e-3
"""How deep a corner may sink in the one step in which it takes over from another, with friction."""


class Ramp:
    """A wall of a kind that the package does not know: steeper the farther along y."""

    def gap(self, point_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y, _ = point_mm.T
        normal = np.column_stack([-np.ones_like(x), -0.2 * y, np.zeros_like(x)])
        length = np.linalg.norm(normal, axis=1)
        return (0.3 - x - 0.1 * y**2) / length, normal / length[:, None]

    def curvature(self, point_mm: np.ndarray) -> np.ndarray:
        return np.zeros((len(point_mm), 3, 3))


WALLS = [
    PlaneWall(point_mm=(0.5, 0.0, 0.0), normal=(-1.0, 0.2, 0.1)),
    PlaneWall(point_mm=(0.5, 0.0, 0.0), normal=(-1.0, 0.0, 0.0)),
    HoleWall(radius_mm=0.7),
    HoleWall(radius_mm=3.0, axis=(0.05, -0.03, 1.0)),
    Ramp(),
]


def random_mount(rng: np.random.Generator) -> np.ndarray:
    """Return a compliance ``(3, 3)`` as anisotropic as the probe's."""
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    upright = np.eye(3) + 0.05 * (basis - np.eye(3))
    return upright @ np.diag([24.0, rng.uniform(3.0, 24.0), 0.4]) @ upright.T


def random_path(rng: np.random.Generator) -> np.ndarray:
    """Return free tip positions about 0.06 mm apart, somewhat more than the rig's longest step."""
    turns = rng.normal(size=(4, 3)) * [1.5, 1.5, 0.02]
    legs = zip([np.zeros(3), *turns[:-1]], turns, strict=True)
    return np.vstack([np.linspace(start, end, 35) for start, end in legs])


@pytest.mark.parametrize("wall", WALLS, ids=["tilted", "plane", "hole", "tilted-hole", "ramp"])
@pytest.mark.parametrize("bit", [RoundBit(), HexBit(heading_rad=0.3)])
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_no_penetration_no_pull_and_no_more_than_the_cone(
    wall: Wall, bit: Bit, friction: float
) -> None:
    rng, touched, rough = np.random.default_rng(7), 0, 0
    for _ in range(1 if isinstance(bit, HexBit) else 3):
        contact, mount = TipContact(bit, wall, friction), random_mount(rng)
        for free in random_path(rng):
            force = contact.solve(free, mount)
            tip = free + mount @ force
            gap, normal = wall.gap(tip + bit.points_mm)
            gap = gap - bit.radius_mm
            pressure = (contact.force_n * normal).sum(axis=1)
            tangential = np.linalg.norm(contact.force_n - pressure[:, None] * normal, axis=1)
            assert gap.min() > -HANDOVER_MM
            assert pressure.min() >= -1e-9
            inside = bool((tangential <= (friction + 1e-3) * pressure + 1e-9).all())
            assert (tangential <= (1.2 * friction + 1e-3) * pressure + 1e-9).all()
            assert (gap[pressure > 1e-6] < HANDOVER_MM).all()
            touched += bool(force.any())
            rough += not inside or bool(gap.min() < -TOLERANCE_MM)
    assert touched > 10
    assert rough <= 0.02 * touched


def test_a_released_tip_forgets_where_it_stuck() -> None:
    contact = TipContact(RoundBit(), WALLS[1], 0.3)
    mount = np.diag([24.0, 24.0, 0.4])
    contact.solve(np.array([1.0, 0.0, 0.0]), mount)
    assert contact.solve(np.array([0.0, 0.0, 0.0]), mount) == pytest.approx(np.zeros(3))
    again = contact.solve(np.array([1.0, 0.5, 0.0]), mount)
    assert again[1] == pytest.approx(0.0, abs=1e-12)
