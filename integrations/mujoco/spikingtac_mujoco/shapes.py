"""Bodies of a MuJoCo model as indenters of the gel: their height over the cells of the skin.

The gel asks for the height of a body along its normal at every cell. Each primitive is a closed
form (the last intersection of a line along the normal), a mesh is a buffer of depth over its
triangles.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

import spikingtac as st
from spikingtac.sim import SoftLayer

Floats = NDArray[np.float64]

MM_PER_M = 1e3
NO_SURFACE_MM = -1e6  # Height where there is no body, far away from any skin, mm.

# Height of the reference point over the body's origin, mm: above any body, so that the gel never
# takes one for out of reach.
REACH_MM = 1e5

# Parts of a mesh that lie further than this above the skin never touch it, mm.
BULGE_MM = 1.0
TINY = 1e-12
GEOM = mujoco.mjtGeom
PLANE, SPHERE, CAPSULE = int(GEOM.mjGEOM_PLANE), int(GEOM.mjGEOM_SPHERE), int(GEOM.mjGEOM_CAPSULE)
ELLIPSOID, CYLINDER = int(GEOM.mjGEOM_ELLIPSOID), int(GEOM.mjGEOM_CYLINDER)
BOX, MESH = int(GEOM.mjGEOM_BOX), int(GEOM.mjGEOM_MESH)
SHAPES = (PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH)


def quadric_top(a: float, b: Floats, c: Floats) -> Floats:
    """Return the larger root of ``a z² + 2 b z + c``, or "not a number"."""
    return (np.sqrt(b * b - a * c) - b) / a if a >= TINY else np.full(b.shape, np.nan)


def round_top(kind: int, size: Floats, axis: Floats, x: Floats, y: Floats) -> Floats:
    """Return the height of a capsule or a cylinder over points, mm."""
    radius, half = size[0], size[1]
    across = x * axis[0] + y * axis[1]
    top = quadric_top(
        1.0 - axis[2] ** 2, -across * axis[2], x * x + y * y - across**2 - radius * radius
    )
    best = np.where(np.abs(across + top * axis[2]) <= half, top, NO_SURFACE_MM)
    for end in (-half, half):
        if kind == CAPSULE:
            rest = radius * radius - (x - end * axis[0]) ** 2 - (y - end * axis[1]) ** 2
            best = np.fmax(best, end * axis[2] + np.sqrt(rest))
        elif abs(axis[2]) > TINY:
            top = (end - across) / axis[2]
            inside = x * x + y * y + top * top - end * end <= radius * radius
            best = np.where(inside, np.maximum(best, top), best)
    return best


def box_top(size: Floats, rotation: Floats, x: Floats, y: Floats) -> Floats:
    """Return the height of a box over points, mm."""
    low, high = np.full(x.shape, -np.inf), np.full(x.shape, np.inf)
    for half, (right, up, slope) in zip(size, rotation.T, strict=True):
        start = right * x + up * y
        if abs(slope) < TINY:
            high[np.abs(start) > half] = -np.inf
            continue
        one, other = (-half - start) / slope, (half - start) / slope
        low = np.maximum(low, np.minimum(one, other))
        high = np.minimum(high, np.maximum(one, other))
    return np.where(low <= high, high, NO_SURFACE_MM)


def ellipsoid_top(size: Floats, rotation: Floats, x: Floats, y: Floats) -> Floats:
    """Return the height of an ellipsoid over points, mm."""
    slope = (rotation[2] / size)[:, np.newaxis]
    start = (np.multiply.outer(rotation[0], x) + np.multiply.outer(rotation[1], y)) / size[:, None]
    c = (start * start).sum(axis=0, initial=-1.0)
    return quadric_top(float((slope * slope).sum()), (slope * start).sum(axis=0), c)


def primitive_top(kind: int, size: Floats, rotation: Floats, x: Floats, y: Floats) -> Floats:
    """Return the height ``(n,)`` of one primitive over points, mm; NaN where there is none.

    Args:
        kind: MuJoCo's type of the geom.
        size: ``(3,)`` its size, mm.
        rotation: ``(3, 3)`` its orientation.
        x: ``(n,)`` points from its centre, mm.
        y: ``(n,)`` points.
    """
    axis = rotation[:, 2]
    with np.errstate(invalid="ignore"):
        if kind == BOX:
            return box_top(size, rotation, x, y)
        if kind in (CAPSULE, CYLINDER):
            return round_top(kind, size, axis, x, y)
        if kind == PLANE:
            height = -(axis[0] * x + axis[1] * y) / axis[2] if axis[2] > TINY else NO_SURFACE_MM
            return np.broadcast_to(height, x.shape)
        return ellipsoid_top(size, rotation, x, y)


@njit(cache=True)
def mesh_kernel(corners: Floats, floor_mm: float, x_mm: Floats, y_mm: Floats, out: Floats) -> None:
    """Raise ``out (n,)`` to the height of triangles ``(t, 3, 3)`` over the points, mm."""
    left, right, top, bottom = x_mm.min(), x_mm.max(), y_mm.min(), y_mm.max()
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        if max(a[2], b[2], c[2]) < floor_mm or max(a[0], b[0], c[0]) < left:
            continue
        if min(a[0], b[0], c[0]) > right or max(a[1], b[1], c[1]) < top:
            continue
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if min(a[1], b[1], c[1]) > bottom or abs(area) < TINY:
            continue
        for i in range(len(x_mm)):
            x, y = x_mm[i], y_mm[i]
            u = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
            v = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                out[i] = max(out[i], a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]))


class BodyIndenter:
    """All geoms of a body that collide, as one rigid indenter (:class:`spikingtac.sim.Indenter`).

    Args:
        model: The model.
        geoms: Numbers of the geoms.
        pad_mm: ``(2,)`` half sides of the pad: the body has no surface beside it, mm.

    Attributes:
        place_mm: ``(3,)`` place of the body's origin from the centre of the skin, mm.
    """

    soft: SoftLayer | None = None

    def __init__(self, model: mujoco.MjModel, geoms: list[int], pad_mm: Floats) -> None:
        self._parts = []
        for g in geoms:
            kind, size = int(model.geom_type[g]), model.geom_size[g] * MM_PER_M
            if kind not in SHAPES:
                name = GEOM(kind).name.removeprefix("mjGEOM_").lower()
                raise st.ConfigError(
                    f"geom {model.geom(g).name!r} touches the pad and is a {name}; the sensor "
                    "feels planes, spheres, capsules, ellipsoids, cylinders, boxes and meshes"
                )
            turn, mesh = np.empty(9), np.empty((0, 3, 3))
            mujoco.mju_quat2Mat(turn, model.geom_quat[g])
            if kind == MESH:
                mesh = _triangles_mm(model, int(model.geom_dataid[g]))
            size = np.full(3, size[0]) if kind == SPHERE else size
            self._parts.append((kind, size, turn.reshape(3, 3), model.geom_pos[g] * MM_PER_M, mesh))
        self._pad_mm = pad_mm
        self.place_mm = np.zeros(3)

    def center_mm(self, rotation: Floats) -> float:
        """Return the height of the body's origin over its reference point, mm."""
        return -REACH_MM

    def heights_mm(self, x_mm: Floats, y_mm: Floats, rotation: Floats) -> Floats:
        """Return the height over points from the body's origin, below the reference point, mm."""
        out = np.full(x_mm.shape, NO_SURFACE_MM)
        for kind, size, turn, place, mesh in self._parts:
            turn, center = rotation @ turn, rotation @ place
            if kind == MESH:
                floor_mm = -self.place_mm[2] - BULGE_MM
                mesh_kernel(mesh @ turn.T + center, floor_mm, x_mm, y_mm, out)
            else:
                top = primitive_top(kind, size, turn, x_mm - center[0], y_mm - center[1])
                out = np.fmax(out, center[2] + top)
        beside = np.abs(x_mm + self.place_mm[0]) > self._pad_mm[0]
        beside |= np.abs(y_mm + self.place_mm[1]) > self._pad_mm[1]
        return np.where(beside, NO_SURFACE_MM, out - REACH_MM)


def _triangles_mm(model: mujoco.MjModel, mesh: int) -> Floats:
    """Return the corners ``(t, 3, 3)`` of a mesh in its own frame, mm."""
    first, faces = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    corners = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(np.float64)
    triangles = model.mesh_face[faces : faces + int(model.mesh_facenum[mesh])]
    return corners[triangles] * MM_PER_M
