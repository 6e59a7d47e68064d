"""Drawings of a design: the parts one above the other, a section, a sheet for each printed part.

Lines are projected by the modeller, which hides what lies behind.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from spikingtac.types import FloatArray
from spikingtac_hardware.layout import Layout, Place
from spikingtac_hardware.optics import Imaging
from spikingtac_hardware.parts import Part, Solid, modeller

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FAR_MM, REACH_MM = 1000.0, 200.0  # Distance of the eye, size of the cutting face, mm.
CURVE_POINTS = 40
TOLERANCE_MM, TURN_RAD = 0.02, 0.3  # Of the triangles that fill a section.
LIFT_MM = 6.0  # Between the parts of the exploded view, mm.
ASIDE_MM = 1e-3  # By which a cut stays off a plane of symmetry, where faces may lie, mm.
INK, FIGURES, RAYS = "#22272b", "#0b3c6f", "#d55e00"

# Part of the sensor -> its colour in the section.
COLORS = {
    "screws": "#b8bdc4", "base": "#8c96a1", "connector": "#d9d4bd", "camera-board": "#297854",
    "event-sensor": "#4d4d4d", "lens-holder": "#424242", "lens": "#808799", "led-board": "#e6e3d6",
    "leds": "#fad659", "shading-plate": "#6f7680", "inserts": "#dba847", "shell": "#8c96a1",
    "window": "#9eccea", "gel": "#bfe0f2", "discs": "#f7f7f7", "cover": "#383838",
}  # fmt: skip

# View -> where the eye stands, and what is up.
VIEWS = {
    "front": ((0.0, -FAR_MM, 0.0), (0.0, 0.0, 1.0)),
    "above": ((0.0, 0.0, FAR_MM), (0.0, 1.0, 0.0)),
    "below": ((0.0, 0.0, -FAR_MM), (0.0, 1.0, 0.0)),
    "slanted": ((400.0, -800.0, 400.0), (0.0, 0.0, 1.0)),
}


def exploded_view(parts: Sequence[Part]) -> Figure:
    """Return the parts of the sensor, each lifted above the one that carries it."""
    figure, (axes,) = _figure((5.0, 11.0), 1)
    for number, part in enumerate(parts):
        lifted = modeller().Pos(0, 0, LIFT_MM * number) * part.solid
        points = np.vstack(_draw(axes, lifted, "slanted", 0.5))
        right = points[points[:, 0].argmax()]
        axes.text(right[0] + 2.0, right[1], part.name, fontsize=8, va="center", color=INK)
    return figure


def section_view(layout: Layout, parts: Sequence[Part]) -> Figure:
    """Return sections beside the axis, with rays to the skin, and through two screws."""
    figure, (left, right) = _figure((10.5, 5.5), 2)
    skin, screw_mm = layout.design.skin, layout.screw_places_mm[-1][1]
    at_axis_mm = 0.0 if skin.grid[0] % 2 else skin.pitch_mm / 2
    for axes, y_mm in ((left, at_axis_mm), (right, screw_mm)):
        for part in parts:
            _fill(axes, part, y_mm + ASIDE_MM)
        axes.set_title(f"{y_mm:.1f} mm beside the axis", fontsize=9)
    _draw_rays(left, layout)
    half, height = layout.outer.half_mm[0], layout.design.housing.height_mm
    _dimension(left, (-half, -1.5), (half, -1.5))
    levels = (0.0, layout.base_top_mm, layout.plate_top_mm, layout.window_bottom_mm,
              layout.window_top_mm, layout.disc_mm, height)  # fmt: skip
    for low, high in itertools.pairwise(levels):
        _dimension(right, (half + 2.0, low), (half + 2.0, high))
    _dimension(right, (half + 5.0, 0.0), (half + 5.0, height))
    labels = left.get_legend_handles_labels()
    figure.legend(*labels, loc="outside lower center", ncols=8, fontsize=7)
    return figure


def sheet(part: Part, design: str, notes: Sequence[str]) -> Figure:
    """Return the drawing of one part: three views with hidden lines and outer dimensions.

    Args:
        part: The part.
        design: Description of the design.
        notes: Lines below it: material, tolerances, holes.
    """
    figure, every = _figure((11.7, 8.3), 3)
    for axes, view in zip(every, ("front", "above", "below"), strict=True):
        seen = np.vstack(_draw(axes, part.solid, view, 0.8, hidden_width=0.3))
        low, high = seen.min(axis=0), seen.max(axis=0)
        _dimension(axes, (low[0], low[1] - 2.0), (high[0], low[1] - 2.0))
        _dimension(axes, (high[0] + 2.0, low[1]), (high[0] + 2.0, high[1]))
        axes.set_title(f"from the {view}" if view == "front" else f"from {view}", fontsize=8)
    lines = (part.name, design, *notes, "lengths in mm     never built or measured")
    figure.text(0.04, 0.04, "\n".join(lines), fontsize=8, va="bottom")
    return figure


def _figure(size_in: tuple[float, float], columns: int) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_in, dpi=200, facecolor="white", layout="constrained")
    every = list(figure.subplots(1, columns, squeeze=False)[0])
    for axes in every:
        axes.set_aspect("equal")
        axes.axis("off")
    return figure, every


def _draw(
    axes: Axes, solid: Solid, view: str, width: float, hidden_width: float = 0.0
) -> list[FloatArray]:
    """Draw the lines of a view; return those that are seen, mm."""
    seen, hidden = (
        [_points(edge, 2 if edge.geom_type.name == "LINE" else CURVE_POINTS) for edge in edges]
        for edges in solid.project_to_viewport(*VIEWS[view], (0.0, 0.0, 0.0))
    )
    style: dict[str, Any] = {"color": INK, "solid_capstyle": "round"}
    for line in hidden if hidden_width else ():
        axes.plot(*line.T[:2], ls=(0, (4, 2.5)), lw=hidden_width, **style)
    for line in seen:
        axes.plot(*line.T[:2], lw=width, **style)
    return seen


def _points(edge: Solid, count: int = CURVE_POINTS) -> FloatArray:
    """Return ``(count, 3)`` points of an edge, mm."""
    places = [edge.position_at(share) for share in np.linspace(0.0, 1.0, count)]
    return np.array([(place.X, place.Y, place.Z) for place in places])


def _fill(axes: Axes, part: Part, y_mm: float) -> None:
    """Draw a part's section by an upright plane."""
    from matplotlib.collections import PolyCollection

    cad, color = modeller(), COLORS[part.name]
    plane = cad.Plane((0, y_mm, 0), x_dir=(1, 0, 0), z_dir=(0, -1, 0))
    knife = (plane * cad.Rectangle(REACH_MM, REACH_MM)).faces()[0]
    boxes = [(solid, solid.bounding_box()) for solid in part.solid.solids()]
    cuts = [solid.intersect(knife) for solid, box in boxes if box.min.Y < y_mm < box.max.Y]
    faces = [face for cut in cuts if cut is not None for face in cut.faces()]
    for number, face in enumerate(faces):
        corners, triangles = face.tessellate(TOLERANCE_MM, TURN_RAD)
        points = np.array([(corner.X, corner.Z) for corner in corners])
        shapes = list(points[np.array(triangles)])
        axes.add_collection(PolyCollection(shapes, fc=color, ec=color, lw=0.1))
        for edge in face.edges():
            axes.plot(*_points(edge).T[[0, 2]], color=INK, lw=0.5)
        axes.fill([], [], color=color, label=None if number else part.name)


def _draw_rays(axes: Axes, layout: Layout) -> None:
    """Draw rays from the lens to the edges of the skin and between them."""
    imaging, edge_mm = Imaging(layout), layout.window.half_mm[0]
    heights = (layout.window_bottom_mm, layout.window_top_mm, layout.disc_mm)
    for reach_mm in np.linspace(-edge_mm, edge_mm, 7):
        tangent = imaging.tangent(np.array([abs(reach_mm)]))
        at = [imaging.radius_mm(tangent, z - layout.window_bottom_mm)[0] for z in heights]
        x = np.sign(reach_mm) * np.array([0.0, *at])
        axes.plot(x, [layout.pupil_mm, *heights], color=RAYS, lw=0.7)


def _dimension(axes: Axes, start: Place, end: Place) -> None:
    """Draw a level or an upright dimension line with its length."""
    length = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    arrow = {"arrowstyle": "<|-|>", "lw": 0.5, "color": FIGURES, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", start, end, arrowprops=arrow, annotation_clip=False)
    middle = (start[0] + end[0]) / 2 + 0.3, (start[1] + end[1]) / 2 + 0.2
    axes.text(*middle, f"{length:.4g}", fontsize=7, color=FIGURES)
