"""The touching points of a tip, relaxed in turn: kernels of ``sim.rig.tip_contact``.

Vectors are tuples of three numbers, which cost nothing; ``tests/naive/test_tip_kernels.py`` has the
same on arrays, as one would write it on paper.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Three = tuple[float, float, float]

SWEEPS = 30
"""Most Gauss-Seidel sweeps; two points of a hexagon need about ten."""
SLIP_STEPS = 12
"""Most fixed-point steps for the direction of slip; the error falls by about 3 with each."""
TOLERANCE_N = 1e-8
"""Change of force at which the sweeps end, N (a millionth of the force at 1 mm of travel)."""
SLIPPING = 1.0 - 1e-6
"""Share of the friction cone's width beyond which a point slips."""


class TipPoints(NamedTuple):
    """What is known of the ``n`` touching points.

    Attributes:
        force_n: ``(n, 3)`` force of the wall on each, N.
        anchor_mm: ``(n, 3)`` tip at which each stuck, mm.
        stuck: ``(n,)`` True where the anchor is valid.
    """

    force_n: Vector
    anchor_mm: Vector
    stuck: NDArray[np.bool_]


class Facing(NamedTuple):
    """The wall as the points see it.

    Attributes:
        gap_mm: ``(n,)`` distances of the points' balls, mm.
        normal: ``(n, 3)`` outward normals.
        bend: ``(n, 3, 3)`` how they turn, see :class:`~spikingtac.sim.rig.walls.Wall`, 1/mm.
    """

    gap_mm: Vector
    normal: Vector
    bend: Vector


class Mount(NamedTuple):
    """The compliant mount of the tip: where it is free, and how it yields.

    Attributes:
        free_mm: ``(3,)`` where the tip is without contact, mm.
        compliance: ``(3, 3)`` tip displacement per force, mm/N.
        stiffness: ``(3, 3)`` its inverse, N/mm.
    """

    free_mm: Vector
    compliance: Vector
    stiffness: Vector


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _row_kernel(rows: Vector, k: int) -> Three:
    return rows[k, 0], rows[k, 1], rows[k, 2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _dot_kernel(a: Three, b: Three) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add_kernel(a: Three, share: float, b: Three) -> Three:
    """Return ``a + share * b``."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _times_kernel(matrix: Vector, a: Three) -> Three:
    return (
        matrix[0, 0] * a[0] + matrix[0, 1] * a[1] + matrix[0, 2] * a[2],
        matrix[1, 0] * a[0] + matrix[1, 1] * a[1] + matrix[1, 2] * a[2],
        matrix[2, 0] * a[0] + matrix[2, 1] * a[1] + matrix[2, 2] * a[2],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def inverse_kernel(matrix: Vector) -> Vector:
    """Return the inverse of a regular ``(3, 3)`` matrix by its cofactors."""
    out = np.empty((3, 3))
    for row in range(3):
        for column in range(3):
            a, b, c, d = (row + 1) % 3, (row + 2) % 3, (column + 1) % 3, (column + 2) % 3
            out[column, row] = matrix[a, c] * matrix[b, d] - matrix[a, d] * matrix[b, c]
    size = matrix[0, 0] * out[0, 0] + matrix[0, 1] * out[1, 0] + matrix[0, 2] * out[2, 0]
    return out / size


@njit(cache=True, nogil=True, error_model="numpy")
def bent_kernel(mount: Mount, corners: TipPoints, facing: Facing, tip_mm: Vector) -> Mount:
    """Return the mount as seen along a bent wall.

    A pressure turns with the normal as the tip slides; to first order that is a spring around the
    present tip, without which a hole narrower than the tip's travel is never solved.

    Args:
        mount: The mount itself.
        corners: Present forces.
        facing: The wall at the present tip.
        tip_mm: ``(3,)`` present tip, mm.
    """
    bend = np.zeros((3, 3))
    for k in range(len(facing.normal)):
        pressure = _dot_kernel(_row_kernel(corners.force_n, k), _row_kernel(facing.normal, k))
        bend += max(pressure, 0.0) * facing.bend[k]
    stiffness = mount.stiffness + bend
    compliance = inverse_kernel(stiffness)
    free, tip = mount.free_mm, tip_mm
    by_mount = _times_kernel(mount.stiffness, (free[0], free[1], free[2]))
    pull = _add_kernel(by_mount, 1.0, _times_kernel(bend, (tip[0], tip[1], tip[2])))
    return Mount(np.array(_times_kernel(compliance, pull)), compliance, stiffness)


@njit(cache=True, nogil=True, error_model="numpy")
def hold_kernel(mount: Mount, free: Three, normal: Three, anchor: Three, friction: float) -> Three:
    """Return the force that keeps a point from ``free`` at its anchor, or lets it slip, N."""
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
        before, share = force, depth / yielding
        force = (cone[0] * share, cone[1] * share, cone[2] * share)
        slide = _add_kernel(_times_kernel(mount.compliance, force), -1.0, away)
        slide = _add_kernel(slide, -_dot_kernel(slide, normal), normal)
        length = math.sqrt(_dot_kernel(slide, slide))
        if length > 0.0:
            direction = (-slide[0] / length, -slide[1] / length, -slide[2] / length)
        if _apart_kernel(force, before) < TOLERANCE_N:
            break
    return force


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _apart_kernel(a: Three, b: Three) -> float:
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(a[2] - b[2]))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _total_kernel(rows: Vector, but: int) -> Three:
    """Return the sum of all rows but one."""
    total = (0.0, 0.0, 0.0)
    for k in range(len(rows)):
        if k != but:
            total = _add_kernel(total, 1.0, _row_kernel(rows, k))
    return total


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _tip_kernel(mount: Mount, force: Three) -> Three:
    free = mount.free_mm
    return _add_kernel((free[0], free[1], free[2]), 1.0, _times_kernel(mount.compliance, force))


@njit(cache=True, nogil=True, error_model="numpy")
def _relax_kernel(
    corners: TipPoints, mount: Mount, normals: Vector, reach: Any, friction: Any
) -> None:
    """Relax the points in turn; ``normal @ tip >= reach`` is what each of them demands."""
    for _ in range(SWEEPS):
        change = 0.0
        for k in range(len(normals)):
            normal = _row_kernel(normals, k)
            others = _tip_kernel(mount, _total_kernel(corners.force_n, k))
            force = (0.0, 0.0, 0.0)
            if reach[k] > _dot_kernel(normal, others):
                anchor = _row_kernel(corners.anchor_mm, k) if corners.stuck[k] else others
                anchor = _add_kernel(anchor, reach[k] - _dot_kernel(normal, anchor), normal)
                force = hold_kernel(mount, others, normal, anchor, friction)
            change = max(change, _apart_kernel(force, _row_kernel(corners.force_n, k)))
            for axis in range(3):
                corners.force_n[k, axis] = force[axis]
        if change < TOLERANCE_N or len(normals) == 1:
            break


@njit(cache=True, nogil=True, error_model="numpy")
def press_kernel(
    corners: TipPoints, facing: Facing, mount: Mount, friction: float, tip_mm: Vector, share: float
) -> None:
    """Solve the contact with the wall linearised at the present tip.

    Args:
        corners: First guess of the forces, overwritten.
        facing: The wall at the present tip.
        mount: The mount itself.
        friction: Coulomb coefficient.
        tip_mm: ``(3,)`` present tip, mm; moved towards the new one.
        share: Of that way.
    """
    bent = bent_kernel(mount, corners, facing, tip_mm)
    here = (tip_mm[0], tip_mm[1], tip_mm[2])
    reach = np.empty(len(facing.gap_mm))
    for k in range(len(reach)):
        reach[k] = _dot_kernel(_row_kernel(facing.normal, k), here) - facing.gap_mm[k]
    _relax_kernel(corners, bent, facing.normal, reach, friction)
    there = _tip_kernel(bent, _total_kernel(corners.force_n, -1))
    for axis in range(3):
        tip_mm[axis] += share * (there[axis] - here[axis])


@njit(cache=True, nogil=True, error_model="numpy")
def remember_kernel(corners: TipPoints, normals: Vector, friction: float, tip_mm: Vector) -> None:
    """Keep the anchor of what stuck; move it along with what slipped or has just touched."""
    for k in range(len(normals)):
        force, normal = _row_kernel(corners.force_n, k), _row_kernel(normals, k)
        pressure = _dot_kernel(force, normal)
        tangential = _add_kernel(force, -pressure, normal)
        size = math.sqrt(_dot_kernel(tangential, tangential))
        slipped = size > friction * pressure * SLIPPING
        if pressure > 0.0 and (slipped or not corners.stuck[k]):
            corners.anchor_mm[k] = tip_mm
        corners.stuck[k] = pressure > 0.0
