"""Plain twins of the kernels behind contact at the tip: as one would write them on arrays."""

import copy

import numpy as np
import pytest

from spikingtac.sim.rig.tip_contact import (
    SLIP_FRACTION,
    SLIP_STEPS,
    SWEEPS,
    TOLERANCE_N,
    CompliantMount,
    LinearisedWall,
    TipPoints,
    solve_linearised_kernel,
    stiffen_by_curvature_kernel,
    update_anchors_kernel,
)
from spikingtac.sim.rig.walls import Bit, HoleWall, PlaneWall, Wall

Array = np.ndarray


def plain_stiffened(
    mount: CompliantMount, points: TipPoints, wall: LinearisedWall, tip: Array
) -> CompliantMount:
    pressure = np.maximum((points.force_n * wall.normal).sum(axis=1), 0.0)
    curvature = np.tensordot(pressure, wall.curvature, axes=1)
    compliance = np.linalg.inv(mount.stiffness + curvature)
    free = compliance @ (mount.stiffness @ mount.free_mm + curvature @ tip)
    return CompliantMount(free, compliance, mount.stiffness + curvature)


def plain_point_force(
    mount: CompliantMount, free: Array, normal: Array, anchor: Array, friction: float
) -> Array:
    stick = mount.stiffness @ (anchor - free)
    pressure = stick @ normal
    tangential = stick - pressure * normal
    size = np.linalg.norm(tangential)
    if pressure > 0.0 and size <= friction * pressure:
        return stick
    direction, force = tangential / size, np.zeros(3)
    for _ in range(SLIP_STEPS):
        cone = normal + friction * direction
        before, yielding = force, normal @ mount.compliance @ cone
        if yielding <= 0.0:
            return stick
        force = cone * (normal @ (anchor - free) / yielding)
        slide = free + mount.compliance @ force - anchor
        slide = slide - (slide @ normal) * normal
        length = np.linalg.norm(slide)
        if length > 0.0:
            direction = -slide / length
        if np.abs(force - before).max() < TOLERANCE_N:
            break
    return force


def plain_solve_linearised(
    points: TipPoints,
    wall: LinearisedWall,
    mount: CompliantMount,
    friction: float,
    tip: Array,
    fraction: float,
) -> Array:
    """Return the new tip; the corners' forces are overwritten."""
    stiffened = plain_stiffened(mount, points, wall, tip)
    reach = wall.normal @ tip - wall.gap_mm
    for _ in range(SWEEPS):
        change = 0.0
        for k, normal in enumerate(wall.normal):
            pull = points.force_n.sum(axis=0) - points.force_n[k]
            others, force = stiffened.free_mm + stiffened.compliance @ pull, np.zeros(3)
            if reach[k] - normal @ others > 0.0:
                anchor = points.anchor_mm[k] if points.stuck[k] else others
                anchor = anchor + normal * (reach[k] - normal @ anchor)
                force = plain_point_force(stiffened, others, normal, anchor, friction)
            change = max(change, np.abs(force - points.force_n[k]).max())
            points.force_n[k] = force
        if change < TOLERANCE_N or len(wall.normal) == 1:
            break
    there = stiffened.free_mm + stiffened.compliance @ points.force_n.sum(axis=0)
    return tip + fraction * (there - tip)


def plain_update_anchors(points: TipPoints, normal: Array, friction: float, tip: Array) -> None:
    pressure = (points.force_n * normal).sum(axis=1)
    tangential = np.linalg.norm(points.force_n - pressure[:, None] * normal, axis=1)
    slipped = tangential > friction * pressure * SLIP_FRACTION
    points.anchor_mm[(pressure > 0.0) & (slipped | ~points.stuck)] = tip
    points.stuck[:] = pressure > 0.0


def mount_of(rng: np.random.Generator, free: Array) -> CompliantMount:
    upright = np.eye(3) + 0.05 * (np.linalg.qr(rng.normal(size=(3, 3)))[0] - np.eye(3))
    compliance = upright @ np.diag([24.0, rng.uniform(3.0, 24.0), 0.4]) @ upright.T
    return CompliantMount(free, compliance, np.linalg.inv(compliance))


PLANE = PlaneWall(point_mm=(0.3, 0.0, 0.0), normal=(-1.0, 0.2, 0.1))
HOLE = HoleWall(radius_mm=0.7, axis=(0.05, -0.03, 1.0))


@pytest.mark.parametrize(
    ("wall", "bit", "friction"),
    [(PLANE, Bit(), 0.3), (HOLE, Bit(), 0.0), (HOLE, Bit(heading_rad=0.3), 0.3)],
)
def test_a_wandering_tip_is_pressed_and_remembered_alike(
    wall: Wall, bit: Bit, friction: float
) -> None:
    rng, count, pressed = np.random.default_rng(2), len(bit.points_mm), 0
    fast = TipPoints(np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count, np.bool_))
    compliance = mount_of(rng, np.zeros(3)).compliance
    for free in np.cumsum(rng.normal([0.02, 0.0, 0.0], 0.05, (80, 3)), axis=0):
        mount = CompliantMount(free, compliance, np.linalg.inv(compliance))
        tip = free + compliance @ fast.force_n.sum(axis=0)
        gap, normal = wall.gap(tip + bit.points_mm)
        curvature = wall.curvature(tip + bit.points_mm)
        linearised = LinearisedWall(gap - bit.radius_mm, normal, curvature)
        plain, place, fraction = copy.deepcopy(fast), tip.copy(), rng.choice([0.5, 1.0])
        stiffened, expected = (
            k(mount, fast, linearised, tip) for k in (stiffen_by_curvature_kernel, plain_stiffened)
        )
        for part, wanted in zip(stiffened, expected, strict=True):
            np.testing.assert_allclose(part, wanted, rtol=1e-9, atol=1e-10)
        solve_linearised_kernel(fast, linearised, mount, friction, place, fraction)
        wanted = plain_solve_linearised(plain, linearised, mount, friction, tip, fraction)
        np.testing.assert_allclose(place, wanted, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(fast.force_n, plain.force_n, rtol=1e-6, atol=1e-6)
        plain = copy.deepcopy(fast)
        update_anchors_kernel(fast, normal, friction, place)
        plain_update_anchors(plain, normal, friction, place)
        np.testing.assert_array_equal(fast.anchor_mm, plain.anchor_mm)
        np.testing.assert_array_equal(fast.stuck, plain.stuck)
        pressed += bool(fast.stuck.any())
    assert pressed > 10
