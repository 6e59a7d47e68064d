"""The exploded view: every part above the one that carries it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from spikingtac_hardware.drawings.look import LOOKS, look_label
from spikingtac_hardware.drawings.mesh import Mesh
from spikingtac_hardware.drawings.shading import Canvas, Shown, View
from spikingtac_hardware.layout import Layout

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AZIMUTH_DEG, ELEVATION_DEG = -62.0, 24.0
PX_PER_MM = 24.0
MARGIN_MM = 1.5
LABEL_MM = 9.0
"""Distance of the names from the parts, mm."""
LABEL_GAP_MM = 3.4
"""Least distance of two names, mm."""
TEXT_PT = 9.0
HIDDEN = ("connector",)
"""Parts that the view hides, and that therefore have no name in it."""
DRAWN_FOR_MM = 19.0
"""Height of the sensor for which the lifts of the parts are given, mm."""
IN_PER_MM = 0.085
"""Inches of the figure for each mm of the sensor."""


def exploded_view(layout: Layout, meshes: Mapping[str, Mesh]) -> Figure:
    """Return the exploded view as a figure.

    Args:
        layout: Heights of the parts.
        meshes: Triangles of every part of the sensor, by name.
    """
    shown = {name: _shown(layout, name, mesh) for name, mesh in meshes.items()}
    view = View(AZIMUTH_DEG, ELEVATION_DEG)
    points = np.concatenate([_seen(one, view) for one in shown.values()])
    low = points[:, :2].min(axis=0) - MARGIN_MM
    high = points[:, :2].max(axis=0) + MARGIN_MM
    canvas = Canvas(low, high, PX_PER_MM)
    canvas.draw(tuple(shown.values()), view)
    texts = {name: look_label(name, layout.design) for name in shown if name not in HIDDEN}
    return _figure(canvas, low, high, _labels(shown, texts, view))


def _shown(layout: Layout, name: str, mesh: Mesh) -> Shown:
    look = LOOKS[name]
    color = look.color
    if layout.design.skin.paint == "dark" and name in ("discs", "cover"):
        color = LOOKS["cover" if name == "discs" else "discs"].color
    lift_mm = look.lift_mm * layout.design.housing.height_mm / DRAWN_FOR_MM
    return Shown(mesh, color, lift_mm, look.opacity)


def _seen(one: Shown, view: View) -> Any:
    return view.seen(one.mesh.corner_mm + np.array([0.0, 0.0, one.lift_mm]))


def _labels(
    shown: Mapping[str, Shown], texts: Mapping[str, str], view: View
) -> list[tuple[str, float, float, float]]:
    """Return text, right end, height of the part, and height of the text, from below to above."""
    labels = []
    for name, text in texts.items():
        points = _seen(shown[name], view)
        middle = (points[:, 1].max() + points[:, 1].min()) / 2
        rightmost = points[np.abs(points[:, 1] - middle) < 0.25 * np.ptp(points[:, 1]) + 0.5]
        best = rightmost[rightmost[:, 0].argmax()]
        labels.append([text, float(best[0]), float(best[1]), float(best[1])])
    labels.sort(key=lambda label: label[3])
    heights = np.array([label[3] for label in labels])
    for _ in range(200):  # push apart what is too close, a little at a time
        close = LABEL_GAP_MM - np.diff(heights)
        push = np.maximum(close, 0.0) / 2
        if not push.any():
            break
        heights[:-1] -= push
        heights[1:] += push
    return [(text, x, y, float(at)) for (text, x, y, _), at in zip(labels, heights, strict=True)]


def _figure(
    canvas: Canvas, low: Any, high: Any, labels: list[tuple[str, float, float, float]]
) -> Figure:
    from matplotlib.figure import Figure

    right = high[0] + LABEL_MM + 21.0
    size = (right - low[0]) * IN_PER_MM, (high[1] - low[1]) * IN_PER_MM
    figure = Figure(figsize=size, dpi=200, facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(canvas.image(), extent=(low[0], high[0], low[1], high[1]))
    for text, x, y, at in labels:
        start = high[0] + LABEL_MM - 5.0
        axes.plot([x + 0.3, start, start + 3.5], [y, at, at], color="#5a6268", lw=0.6)
        axes.plot([x + 0.3], [y], ".", color="#5a6268", ms=3)
        axes.text(start + 4.2, at, text, va="center", fontsize=TEXT_PT, color="#1a1a1a")
    axes.set(xlim=(low[0], right), ylim=(low[1], high[1]), aspect="equal")
    axes.axis("off")
    return figure
