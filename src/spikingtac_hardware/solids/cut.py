"""Sections of solids: closed outlines in an upright plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac_hardware.solids.cad import Solid, modeller

CURVE_POINTS = 25
"""Points on a curved edge."""
REACH_MM = 200.0
"""Size of the cutting face, mm: larger than any part."""


@dataclass(frozen=True, slots=True)
class CutFace:
    """One face of a section.

    Attributes:
        outer_mm: ``(n, 2)`` its outline, x and z, counter-clockwise, mm.
        holes_mm: Outlines ``(k, 2)`` of its holes, clockwise.
    """

    outer_mm: FloatArray
    holes_mm: tuple[FloatArray, ...]


def cut_faces(solid: Solid, y_mm: float) -> list[CutFace]:
    """Return the faces of a solid's section by the upright plane at ``y_mm``."""
    cad = modeller()
    plane = cad.Plane((0, y_mm, 0), x_dir=(1, 0, 0), z_dir=(0, -1, 0))
    knife = plane * cad.Rectangle(REACH_MM, REACH_MM)
    faces = []
    for one in solid.solids():
        box = one.bounding_box()
        if not box.min.Y < y_mm < box.max.Y:
            continue
        common = one.intersect(knife.faces()[0])
        for face in [] if common is None else common.faces():
            holes = tuple(_turned(_points(wire), False) for wire in face.inner_wires())
            faces.append(CutFace(_turned(_points(face.outer_wire()), True), holes))
    return faces


def _points(wire: Solid) -> FloatArray:
    """Return the points of a closed wire, its edges one after the other."""
    left = [_edge_points(edge) for edge in wire.edges()]
    chain = left.pop(0)
    while left:
        gaps = [
            (float(np.linalg.norm(points[end] - chain[-1])), index, end)
            for index, points in enumerate(left)
            for end in (0, -1)
        ]
        _, index, end = min(gaps)
        points = left.pop(index)
        chain = np.vstack([chain, (points if end == 0 else points[::-1])[1:]])
    return chain


def _edge_points(edge: Solid) -> FloatArray:
    count = 2 if edge.geom_type.name == "LINE" else CURVE_POINTS
    places = [edge.position_at(share) for share in np.linspace(0.0, 1.0, count)]
    return np.array([(place.X, place.Z) for place in places])


def _turned(points: FloatArray, counter_clockwise: bool) -> FloatArray:
    x, z = points.T
    area = float(x @ np.roll(z, -1) - z @ np.roll(x, -1))
    return points if (area > 0) == counter_clockwise else points[::-1]
