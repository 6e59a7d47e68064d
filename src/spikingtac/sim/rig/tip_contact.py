"""Kernels of :mod:`spikingtac.sim.rig.walls`: the touching points of a tip, solved in turn.

Vectors are tuples of three numbers, which need no memory allocation.
``tests/naive/test_tip_kernels.py`` has the same equations on arrays.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.arrays import FloatArray

Three = tuple[float, float, float]

SWEEPS = 30  # Largest number of Gauss-Seidel sweeps; two points of a hexagon need about ten.

# Largest number of fixed-point steps for the slip direction; each divides the error by about 3.
SLIP_STEPS = 12

# Change of force at which the sweeps end, N (a millionth of the force at 1 mm of travel).
TOLERANCE_N = 1e-8
SLIP_FRACTION = 1.0 - 1e-6  # Fraction of the friction cone's width beyond which a point slips.


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
def _row_kernel(rows: FloatArray, k: int) -> Three:
    return rows[k, 0], rows[k, 1], rows[k, 2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _dot_kernel(a: Three, b: Three) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add_kernel(a: Three, fraction: float, b: Three) -> Three:
    """Return ``a + fraction * b``."""
    return a[0] + fraction * b[0], a[1] + fraction * b[1], a[2] + fraction * b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _times_kernel(matrix: FloatArray, a: Three) -> Three:
    return (
        matrix[0, 0] * a[0] + matrix[0, 1] * a[1] + matrix[0, 2] * a[2],
        matrix[1, 0] * a[0] + matrix[1, 1] * a[1] + matrix[1, 2] * a[2],
        matrix[2, 0] * a[0] + matrix[2, 1] * a[1] + matrix[2, 2] * a[2],
    )


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
        pressure = _dot_kernel(_row_kernel(points.force_n, k), _row_kernel(wall.normal, k))
        curvature += max(pressure, 0.0) * wall.curvature[k]
    stiffness = mount.stiffness + curvature
    compliance = inverse_kernel(stiffness)
    free, tip = mount.free_mm, tip_mm
    by_mount = _times_kernel(mount.stiffness, (free[0], free[1], free[2]))
    pull = _add_kernel(by_mount, 1.0, _times_kernel(curvature, (tip[0], tip[1], tip[2])))
    return CompliantMount(np.array(_times_kernel(compliance, pull)), compliance, stiffness)


@njit(cache=True, nogil=True, error_model="numpy")
def point_force_kernel(
    mount: CompliantMount, free: Three, normal: Three, anchor: Three, friction: float
) -> Three:
    """Return the force that keeps a point at its anchor, or the force at which it slips, N.

    Args:
        mount: The mount, stiffened by the wall's curvature.
        free: Position of the tip without this point's force, mm.
        normal: Outward normal of the wall.
        anchor: Anchor of the point, on the wall's surface, mm.
        friction: Coefficient of friction.
    """
    away = _add_kernel(anchor, -1.0, free)
    stick = _times_kernel(mount.stiffness, away)
    pressure = _dot_kernel(stick, normal)
    tangential = _add_kernel(stick, -pressure, normal)
    size = math.sqrt(_dot_kernel(tangential, tangential))
    if pressure > 0.0 and size <= friction * pressure:
        return stick
    depth = _dot_kernel(normal, away)
    direction = (tangential[0] / size, tangential[1] / size, tangential[2] / size)
    force = (0.0, 0.0, 0.0)
    for _ in range(SLIP_STEPS):
        cone = _add_kernel(normal, friction, direction)
        yielding = _dot_kernel(normal, _times_kernel(mount.compliance, cone))
        if yielding <= 0.0:  # the tip jams: no slip can undo the penetration (Painleve)
            return stick
        before, fraction = force, depth / yielding
        force = (cone[0] * fraction, cone[1] * fraction, cone[2] * fraction)
        slide = _add_kernel(_times_kernel(mount.compliance, force), -1.0, away)
        slide = _add_kernel(slide, -_dot_kernel(slide, normal), normal)
        length = math.sqrt(_dot_kernel(slide, slide))
        if length > 0.0:
            direction = (-slide[0] / length, -slide[1] / length, -slide[2] / length)
        if _max_difference_kernel(force, before) < TOLERANCE_N:
            break
    return force


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _max_difference_kernel(a: Three, b: Three) -> float:
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(a[2] - b[2]))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sum_kernel(rows: FloatArray, excluded: int) -> Three:
    """Return the sum of all rows except one."""
    total = (0.0, 0.0, 0.0)
    for k in range(len(rows)):
        if k != excluded:
            total = _add_kernel(total, 1.0, _row_kernel(rows, k))
    return total


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _tip_kernel(mount: CompliantMount, force: Three) -> Three:
    free = mount.free_mm
    return _add_kernel((free[0], free[1], free[2]), 1.0, _times_kernel(mount.compliance, force))


@njit(cache=True, nogil=True, error_model="numpy")
def _relax_kernel(
    points: TipPoints, mount: CompliantMount, normals: FloatArray, reach: Any, friction: Any
) -> None:
    """Solve the points in turn. The constraint of each point is ``normal @ tip >= reach``."""
    for _ in range(SWEEPS):
        change = 0.0
        for k in range(len(normals)):
            normal = _row_kernel(normals, k)
            others = _tip_kernel(mount, _sum_kernel(points.force_n, k))
            force = (0.0, 0.0, 0.0)
            if reach[k] > _dot_kernel(normal, others):
                anchor = _row_kernel(points.anchor_mm, k) if points.stuck[k] else others
                anchor = _add_kernel(anchor, reach[k] - _dot_kernel(normal, anchor), normal)
                force = point_force_kernel(mount, others, normal, anchor, friction)
            change = max(change, _max_difference_kernel(force, _row_kernel(points.force_n, k)))
            for axis in range(3):
                points.force_n[k, axis] = force[axis]
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
    here = (tip_mm[0], tip_mm[1], tip_mm[2])
    reach = np.empty(len(wall.gap_mm))
    for k in range(len(reach)):
        reach[k] = _dot_kernel(_row_kernel(wall.normal, k), here) - wall.gap_mm[k]
    _relax_kernel(points, stiffened, wall.normal, reach, friction)
    there = _tip_kernel(stiffened, _sum_kernel(points.force_n, -1))
    for axis in range(3):
        tip_mm[axis] += fraction * (there[axis] - here[axis])


@njit(cache=True, nogil=True, error_model="numpy")
def update_anchors_kernel(
    points: TipPoints, normals: FloatArray, friction: float, tip_mm: FloatArray
) -> None:
    """Keep the anchors of sticking points; move those of points that slip or have just touched."""
    for k in range(len(normals)):
        force, normal = _row_kernel(points.force_n, k), _row_kernel(normals, k)
        pressure = _dot_kernel(force, normal)
        tangential = _add_kernel(force, -pressure, normal)
        size = math.sqrt(_dot_kernel(tangential, tangential))
        slipped = size > friction * pressure * SLIP_FRACTION
        if pressure > 0.0 and (slipped or not points.stuck[k]):
            points.anchor_mm[k] = tip_mm
        points.stuck[k] = pressure > 0.0
