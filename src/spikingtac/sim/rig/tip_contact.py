"""Kernels of :mod:`spikingtac.sim.rig.walls`: the touching points of a tip, solved in turn."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.gel_contact import SLIP_FRACTION
from spikingtac.types import FloatArray

SWEEPS = 30  # Largest number of Gauss-Seidel sweeps; two points of a hexagon need about ten.

# Largest number of fixed-point steps for the slip direction; each divides the error by about 3.
SLIP_STEPS = 12

# Change of force at which the sweeps end, N (a millionth of the force at 1 mm of travel).
TOLERANCE_N = 1e-8


class TipPoints(NamedTuple):
    """State of the ``n`` touching points.

    Attributes:
        force_n: ``(n, 3)`` force of the wall on each, N.
        anchor_mm: ``(n, 3)`` tip position at which each point stuck, mm.
        stuck: ``(n,)`` True where the anchor is valid.
    """

    force_n: FloatArray
    anchor_mm: FloatArray
    stuck: NDArray[np.bool_]


class LinearisedWall(NamedTuple):
    """The wall, linearised at each point.

    Attributes:
        gap_mm: ``(n,)`` distances of the points' balls, mm.
        normal: ``(n, 3)`` outward normals.
        curvature: ``(n, 3, 3)`` curvature tensors; see :class:`~spikingtac.sim.rig.walls.Wall`,
            1/mm.
    """

    gap_mm: FloatArray
    normal: FloatArray
    curvature: FloatArray


class CompliantMount(NamedTuple):
    """The compliant mount of the tip.

    Attributes:
        free_mm: ``(3,)`` position of the tip without contact, mm.
        compliance: ``(3, 3)`` tip displacement per force, mm/N.
        stiffness: ``(3, 3)`` inverse of the compliance, N/mm.
    """

    free_mm: FloatArray
    compliance: FloatArray
    stiffness: FloatArray


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _dot_kernel(a: FloatArray, b: FloatArray) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _times_kernel(matrix: FloatArray, a: FloatArray) -> FloatArray:
    out = np.empty(3)
    for row in range(3):  # in this order, so that the last digits are fixed
        out[row] = matrix[row, 0] * a[0] + matrix[row, 1] * a[1] + matrix[row, 2] * a[2]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def inverse_kernel(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a regular ``(3, 3)`` matrix by its cofactors."""
    out = np.empty((3, 3))
    for row in range(3):
        for column in range(3):
            a, b, c, d = (row + 1) % 3, (row + 2) % 3, (column + 1) % 3, (column + 2) % 3
            out[column, row] = matrix[a, c] * matrix[b, d] - matrix[a, d] * matrix[b, c]
    size = matrix[0, 0] * out[0, 0] + matrix[0, 1] * out[1, 0] + matrix[0, 2] * out[2, 0]
    return out / size


@njit(cache=True, nogil=True, error_model="numpy")
def stiffen_by_curvature_kernel(
    mount: CompliantMount, points: TipPoints, wall: LinearisedWall, tip_mm: FloatArray
) -> CompliantMount:
    """Return the mount with the stiffness that a curved wall adds.

    The pressure turns with the normal as the tip slides. To first order that is a spring around the
    present tip. Without it the iteration does not converge in a hole that is narrower than the
    tip's travel.

    Args:
        mount: The mount itself.
        points: Present forces.
        wall: The wall at the present tip.
        tip_mm: ``(3,)`` present tip, mm.
    """
    curvature = np.zeros((3, 3))
    for k in range(len(wall.normal)):
        pressure = _dot_kernel(points.force_n[k], wall.normal[k])
        curvature += max(pressure, 0.0) * wall.curvature[k]
    stiffness = mount.stiffness + curvature
    compliance = inverse_kernel(stiffness)
    pull = _times_kernel(mount.stiffness, mount.free_mm) + _times_kernel(curvature, tip_mm)
    return CompliantMount(_times_kernel(compliance, pull), compliance, stiffness)


@njit(cache=True, nogil=True, error_model="numpy")
def point_force_kernel(
    mount: CompliantMount,
    free: FloatArray,
    normal: FloatArray,
    anchor: FloatArray,
    friction: float,
) -> FloatArray:
    """Return the force that keeps a point at its anchor, or the force at which it slips, N.

    Args:
        mount: The mount, stiffened by the wall's curvature.
        free: Position of the tip without this point's force, mm.
        normal: Outward normal of the wall.
        anchor: Anchor of the point, on the wall's surface, mm.
        friction: Coefficient of friction.
    """
    away = anchor - free
    stick = _times_kernel(mount.stiffness, away)
    pressure = _dot_kernel(stick, normal)
    tangential = stick - pressure * normal
    size = math.sqrt(_dot_kernel(tangential, tangential))
    if pressure > 0.0 and size <= friction * pressure:
        return stick
    depth, direction, force = _dot_kernel(normal, away), tangential / size, np.zeros(3)
    for _ in range(SLIP_STEPS):
        cone = normal + friction * direction
        yielding = _dot_kernel(normal, _times_kernel(mount.compliance, cone))
        if yielding <= 0.0:  # the tip jams: no slip can undo the penetration (Painleve)
            return stick
        before, force = force, cone * (depth / yielding)
        slide = _times_kernel(mount.compliance, force) - away
        slide = slide - _dot_kernel(slide, normal) * normal
        length = math.sqrt(_dot_kernel(slide, slide))
        if length > 0.0:
            direction = -slide / length
        if np.abs(force - before).max() < TOLERANCE_N:
            break
    return force


@njit(cache=True, nogil=True, error_model="numpy")
def _tip_kernel(mount: CompliantMount, force_n: FloatArray, excluded: int) -> FloatArray:
    """Return the tip under the forces of all points except one."""
    total = np.zeros(3)
    for k in range(len(force_n)):
        if k != excluded:
            total += force_n[k]
    return mount.free_mm + _times_kernel(mount.compliance, total)


@njit(cache=True, nogil=True, error_model="numpy")
def _relax_kernel(
    points: TipPoints,
    mount: CompliantMount,
    normals: FloatArray,
    reach: FloatArray,
    friction: float,
) -> None:
    """Solve the points in turn. The constraint of each point is ``normal @ tip >= reach``."""
    for _ in range(SWEEPS):
        change = 0.0
        for k in range(len(normals)):
            normal, force = normals[k], np.zeros(3)
            others = _tip_kernel(mount, points.force_n, k)
            if reach[k] > _dot_kernel(normal, others):
                anchor = points.anchor_mm[k] if points.stuck[k] else others
                anchor = anchor + (reach[k] - _dot_kernel(normal, anchor)) * normal
                force = point_force_kernel(mount, others, normal, anchor, friction)
            change = max(change, np.abs(force - points.force_n[k]).max())
            points.force_n[k] = force
        if change < TOLERANCE_N or len(normals) == 1:
            break


@njit(cache=True, nogil=True, error_model="numpy")
def solve_linearised_kernel(
    points: TipPoints,
    wall: LinearisedWall,
    mount: CompliantMount,
    friction: float,
    tip_mm: FloatArray,
    fraction: float,
) -> None:
    """Solve the contact with the wall linearised at the present tip.

    Args:
        points: First guess of the forces, overwritten.
        wall: The wall at the present tip.
        mount: The mount itself.
        friction: Coefficient of friction.
        tip_mm: ``(3,)`` present tip, mm; moved towards the solution.
        fraction: Fraction of the way to the solution by which the tip moves.
    """
    stiffened = stiffen_by_curvature_kernel(mount, points, wall, tip_mm)
    reach = np.empty(len(wall.gap_mm))
    for k in range(len(reach)):
        reach[k] = _dot_kernel(wall.normal[k], tip_mm) - wall.gap_mm[k]
    _relax_kernel(points, stiffened, wall.normal, reach, friction)
    tip_mm += fraction * (_tip_kernel(stiffened, points.force_n, -1) - tip_mm)


@njit(cache=True, nogil=True, error_model="numpy")
def update_anchors_kernel(
    points: TipPoints, normals: FloatArray, friction: float, tip_mm: FloatArray
) -> None:
    """Keep the anchors of sticking points; move those of points that slip or have just touched."""
    for k in range(len(normals)):
        pressure = _dot_kernel(points.force_n[k], normals[k])
        tangential = points.force_n[k] - pressure * normals[k]
        size = math.sqrt(_dot_kernel(tangential, tangential))
        slipped = size > friction * pressure * SLIP_FRACTION
        if pressure > 0.0 and (slipped or not points.stuck[k]):
            points.anchor_mm[k] = tip_mm
        points.stuck[k] = pressure > 0.0
