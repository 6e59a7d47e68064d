"""Triangles of parts, and the edges at which a drawing shows a line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.arrays import FloatArray
from spikingtac_hardware.solids.cad import Solid, mesh_checker

TOLERANCE_MM = 0.01
"""Largest distance of a triangle from its surface, mm (an eighth of a layer of powder)."""
TURN_RAD = 0.4
"""Largest turn between neighbouring triangles of a curved surface, rad."""
CREASE_RAD = 0.6
"""Turn from which on an edge is drawn, rad: more than that between triangles of one surface."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles of one part.

    Attributes:
        corner_mm: ``(n, 3)`` corners, mm.
        triangle: ``(t, 3)`` their numbers, counter-clockwise seen from outside.
        crease: ``(e, 2)`` numbers of the ends of edges that are drawn.
        closed: True where every edge has two triangles.
        volume_mm3: Enclosed volume, mm³.
    """

    corner_mm: FloatArray
    triangle: NDArray[np.int64]
    crease: NDArray[np.int64]
    closed: bool
    volume_mm3: float


def mesh_of(solid: Solid) -> Mesh:
    """Return the triangles of a solid, checked and joined by trimesh."""
    corners, triangles = solid.tessellate(TOLERANCE_MM, TURN_RAD)
    points = np.array([(corner.X, corner.Y, corner.Z) for corner in corners])
    mesh = mesh_checker().Trimesh(points, np.array(triangles, np.int64), process=True)
    mesh.merge_vertices()
    sharp = mesh.face_adjacency_angles > CREASE_RAD
    return Mesh(
        corner_mm=np.asarray(mesh.vertices, np.float64),
        triangle=np.asarray(mesh.faces, np.int64),
        crease=np.asarray(mesh.face_adjacency_edges[sharp], np.int64),
        closed=bool(mesh.is_watertight and mesh.is_winding_consistent),
        volume_mm3=float(mesh.volume),
    )
