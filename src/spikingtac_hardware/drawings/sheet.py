"""A drawing of one part: two or three views with hidden lines, dimensions, a title block.

Every view says from where it is seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac_hardware.drawings.dimensions import Dimension, draw_dimension
from spikingtac_hardware.drawings.mesh import Mesh
from spikingtac_hardware.drawings.shading import Canvas, Shown, View
from spikingtac_hardware.solids.cad import Solid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Face = Literal["front", "above", "below"]

PAGE_MM = (297.0, 210.0)
"""Size of the page, mm: A4."""
FRAME_MM = 10.0
TOP_SHARE = 0.36
"""Where the middle of the views stands, as a share of the page's height from above."""
PICTURE_COLOR = (0.62, 0.66, 0.71)
BLOCK_MM = (110.0, 30.0)
"""Size of the title block, mm."""
GAP_MM = 22.0
"""Room about each view on paper, for its dimensions, mm."""
NARROW_MM = 5.0
"""Length on paper below which the figure of a height stands beside its line, mm."""
PICTURE_MM = 62.0
"""Largest width and height of the shaded picture, mm."""
AZIMUTH_DEG, ELEVATION_DEG, PICTURE_PX_PER_MM = -55.0, 32.0, 10.0
SCALES = (5.0, 4.0, 3.5, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5)
MM_PER_IN = 25.4
CURVE_POINTS = 60
FAR_MM = 1000.0
"""Distance of the eye, mm; the projection is parallel."""
EYES: dict[Face, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "front": ((0.0, -FAR_MM, 0.0), (0.0, 0.0, 1.0)),
    "above": ((0.0, 0.0, FAR_MM), (0.0, 1.0, 0.0)),
    "below": ((0.0, 0.0, -FAR_MM), (0.0, 1.0, 0.0)),
}
"""Face -> where the eye stands, and what is up."""
SEEN_FROM: dict[Face, str] = {
    "front": "from the front", "above": "from above", "below": "from below",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TitleBlock:
    """The text of a drawing's title block.

    Attributes:
        name: Of the part.
        design: Description of the design.
        material: Material and process.
        note: Tolerances, or what else must be known.
    """

    name: str
    design: str
    material: str
    note: str


@dataclass(frozen=True, slots=True)
class Lines:
    """The lines of one view.

    Attributes:
        seen_mm: Polylines ``(k, 2)`` that are seen, mm.
        hidden_mm: Those behind the part's faces.
    """

    seen_mm: list[FloatArray]
    hidden_mm: list[FloatArray]

    @property
    def box_mm(self) -> tuple[FloatArray, FloatArray]:
        """Lower left and upper right corner, mm."""
        points = np.vstack(self.seen_mm)
        return points.min(axis=0), points.max(axis=0)


def project(solid: Solid, face: Face) -> Lines:
    """Return the lines of a view, hidden ones apart."""
    eye, up = EYES[face]
    seen, hidden = solid.project_to_viewport(eye, up, (0.0, 0.0, 0.0))
    return Lines([_polyline(edge) for edge in seen], [_polyline(edge) for edge in hidden])


def draw_sheet(
    solid: Solid, mesh: Mesh, dimensions: Mapping[Face, Sequence[Dimension]], block: TitleBlock
) -> Figure:
    """Return the drawing of one part.

    Args:
        solid: The part.
        mesh: Its triangles, for a small picture.
        dimensions: Face -> its dimensions, in the view's own coordinates, mm; the views that are
            drawn, in the order in which they are placed.
        block: Text of the title block.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PAGE_MM[0] / MM_PER_IN, PAGE_MM[1] / MM_PER_IN), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, PAGE_MM[0]), ylim=(0, PAGE_MM[1]), aspect="equal")
    axes.axis("off")
    views: dict[Face, Lines] = {face: project(solid, face) for face in dimensions}
    scale = _scale(views)
    left = FRAME_MM
    for face, lines in views.items():
        low, high = lines.box_mm
        middle = PAGE_MM[1] - FRAME_MM - TOP_SHARE * (PAGE_MM[1] - 2 * FRAME_MM)
        shift = np.array([left + GAP_MM, middle]) - scale * np.array([low[0], (low + high)[1] / 2])
        _draw_lines(axes, lines, scale, shift)
        x, y = scale * np.array([(low + high)[0] / 2, low[1]]) + shift
        axes.text(float(x), float(y) - 18.0, SEEN_FROM[face], ha="center", fontsize=8)
        for dimension in dimensions[face]:
            draw_dimension(axes, _on_paper(dimension, scale, shift))
        left += scale * (high - low)[0] + 2 * GAP_MM
    _draw_picture(axes, mesh)
    _draw_block(axes, block, scale)
    return figure


def _scale(views: Mapping[Face, Lines]) -> float:
    boxes = [lines.box_mm for lines in views.values()]
    wide = sum(float((high - low)[0]) for low, high in boxes)
    tall = max(float((high - low)[1]) for low, high in boxes)
    room_x = PAGE_MM[0] - 2 * FRAME_MM - 2 * GAP_MM * len(boxes)
    room_y = 2 * TOP_SHARE * (PAGE_MM[1] - 2 * FRAME_MM) - 2 * GAP_MM
    fitting = [scale for scale in SCALES if scale * wide <= room_x and scale * tall <= room_y]
    return fitting[0] if fitting else SCALES[-1]


def _on_paper(dimension: Dimension, scale: float, shift: FloatArray) -> Dimension:
    start, end = (
        (scale * x + float(shift[0]), scale * y + float(shift[1]))
        for x, y in (dimension.start_mm, dimension.end_mm)
    )
    return replace(dimension, start_mm=start, end_mm=end, narrow_mm=NARROW_MM)


def _draw_lines(axes: Axes, lines: Lines, scale: float, shift: FloatArray) -> None:
    for group, style, width in ((lines.hidden_mm, (0, (4, 2.5)), 0.3), (lines.seen_mm, "-", 0.8)):
        for line in group:
            axes.plot(*(scale * line + shift).T, color="black", ls=style, lw=width,
                      solid_capstyle="round")  # fmt: skip


def _draw_picture(axes: Axes, mesh: Mesh) -> None:
    view, shown = View(AZIMUTH_DEG, ELEVATION_DEG), Shown(mesh, PICTURE_COLOR)
    points = view.seen(mesh.corner_mm)[:, :2]
    low, high = points.min(axis=0) - 0.5, points.max(axis=0) + 0.5
    scale = min(PICTURE_MM / float((high - low).max()), 2.0)
    canvas = Canvas(low, high, PICTURE_PX_PER_MM * scale)
    canvas.draw([shown], view)
    left, lower = FRAME_MM + 14.0, FRAME_MM + 6.0
    width, height = scale * (high - low)
    axes.imshow(canvas.image(), extent=(left, left + width, lower, lower + height), zorder=-1)


def _draw_block(axes: Axes, block: TitleBlock, scale: float) -> None:
    from matplotlib.patches import Rectangle

    width, height = PAGE_MM
    inner = width - 2 * FRAME_MM, height - 2 * FRAME_MM
    axes.add_patch(Rectangle((FRAME_MM, FRAME_MM), *inner, fill=False, lw=1.0))
    x, y = width - FRAME_MM - BLOCK_MM[0], FRAME_MM
    axes.add_patch(Rectangle((x, y), *BLOCK_MM, fill=False, lw=0.8))
    ratio = f"{scale:g} : 1" if scale >= 1 else f"1 : {1 / scale:g}"
    axes.text(x + 3, y + BLOCK_MM[1] - 7, block.name, fontsize=12, weight="bold")
    rows = (block.design, block.material, block.note,
            f"scale {ratio}     lengths in mm     never built or measured")  # fmt: skip
    for row, text in enumerate(rows):
        axes.text(x + 3, y + BLOCK_MM[1] - 12.5 - 4.6 * row, text, fontsize=6.5)


def _polyline(edge: Solid) -> FloatArray:
    straight = edge.geom_type.name == "LINE"
    count = 2 if straight else CURVE_POINTS
    places = [edge.position_at(share) for share in np.linspace(0.0, 1.0, count)]
    return np.array([(place.X, place.Y) for place in places])
