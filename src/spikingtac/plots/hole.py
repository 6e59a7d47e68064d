"""The picture of a hole: estimate, contacts, and the confidence ellipse of the centre.

Errors of some hundredths of a millimetre are not visible beside a radius of millimetres. Residuals,
ellipse and the distance of the true centre are therefore magnified by the factors in the legend.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle as Disc
from matplotlib.patches import Ellipse

from spikingtac.atomic_files import replacing
from spikingtac.geometry.hole import Circle
from spikingtac.types import FloatArray

PLANE_REGION = 5.991
"""95 % quantile of chi-squared with two degrees of freedom: the centre alone."""
FACTORS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Possible magnifications; the largest that fits is taken."""
CENTER_FRACTION, RESIDUAL_FRACTION = 0.5, 0.25
"""Largest size of ellipse and residuals as a fraction of the radius."""
HALF_WIDTH = 1.3
"""Half the picture's width, in radii: the residuals need room outside."""
ESTIMATE_COLOR, TRUTH_COLOR, CONTACT_COLOR = "#0969da", "#cf222e", "#1f2328"
TRUTH_WIDTH, ESTIMATE_WIDTH = 3.0, 1.2
"""Line widths: the estimate is a thin line over the broad one of the truth."""
WIDTH_IN, HEIGHT_IN, DPI = 6.4, 7.2, 130


@dataclass(frozen=True, kw_only=True)
class HolePicture:
    """The content of the picture of one hole.

    Attributes:
        circle: The estimate; its residuals belong to the readings. None where there is none.
        reading_mm: ``(n, 2)`` the arm's positions at the decisions, mm.
        true_center_mm: ``(2,)`` mm, where it is known.
        true_radius_mm: The same of the radius, mm.
    """

    circle: Circle | None
    reading_mm: FloatArray
    true_center_mm: FloatArray | None = None
    true_radius_mm: float | None = None

    @property
    def frame_mm(self) -> tuple[FloatArray, float]:
        """Centre and radius of the frame: of the true circle, the estimate, or the readings."""
        if self.true_center_mm is not None and self.true_radius_mm is not None:
            return self.true_center_mm, self.true_radius_mm
        if self.circle is not None:
            return self.circle.center_mm, self.circle.radius_mm
        middle = self.reading_mm.mean(axis=0)
        return middle, float(np.linalg.norm(self.reading_mm - middle, axis=1).max())

    @property
    def center_factor(self) -> float:
        """Magnification of ellipse and true centre, one of :data:`FACTORS`."""
        if self.circle is None:
            return FACTORS[0]
        largest_mm2 = np.linalg.eigvalsh(self.circle.covariance_mm2[:2, :2])[-1]
        size = float(np.sqrt(PLANE_REGION * largest_mm2))
        if self.true_center_mm is not None:
            away = np.linalg.norm(self.true_center_mm - self.circle.center_mm)
            size = max(size, float(away))
        return _fitting(size, CENTER_FRACTION * self.circle.radius_mm)

    @property
    def residual_factor(self) -> float:
        """Magnification of the residuals, one of :data:`FACTORS`."""
        if self.circle is None:
            return FACTORS[0]
        size = float(np.abs(self.circle.residual_mm).max(initial=0.0))
        return _fitting(size, RESIDUAL_FRACTION * self.circle.radius_mm)


def save_hole_plot(path: str | Path, title: str, picture: HolePicture) -> None:
    """Write the picture of one hole.

    Args:
        path: PNG, SVG or PDF file.
        title: Above it; says whether it is simulated.
        picture: What was found.
    """
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    draw_hole(axes, picture)
    axes.set(xlabel="x of the arm, mm", ylabel="y of the arm, mm")
    axes.grid(alpha=0.25)
    figure.suptitle(title, fontsize=9)
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8
    )
    with replacing(path) as partial:
        figure.savefig(partial)


def draw_hole(axes: Axes, picture: HolePicture) -> None:
    """Draw truth, estimate, contacts and confidence ellipse, to equal scale, with their labels."""
    middle, radius = picture.frame_mm
    if picture.true_center_mm is not None and picture.true_radius_mm is not None:
        disc = _ring(picture.true_center_mm, picture.true_radius_mm, TRUTH_COLOR, TRUTH_WIDTH)
        disc.set(alpha=0.35, label=f"true hole, R {picture.true_radius_mm:.3f} mm")
        axes.add_patch(disc)
    if picture.circle is None:
        axes.plot(*picture.reading_mm.T, ".", color=CONTACT_COLOR, label="readings, no estimate")
    else:
        _draw_estimate(axes, picture, picture.circle)
    x, y, half = float(middle[0]), float(middle[1]), HALF_WIDTH * radius
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
    axes.set_aspect("equal")


def _draw_estimate(axes: Axes, picture: HolePicture, circle: Circle) -> None:
    times = picture.center_factor
    ring = _ring(circle.center_mm, circle.radius_mm, ESTIMATE_COLOR, ESTIMATE_WIDTH)
    ring.set_label(f"estimate, R {circle.radius_mm:.3f} mm")
    axes.add_patch(ring)
    axes.plot(
        *circle.center_mm, "+", color=ESTIMATE_COLOR, ms=8, ls="none", label="estimated centre"
    )
    axes.add_patch(_region(circle, times, f"95 % region of the centre × {times:g}"))
    if picture.true_center_mm is not None:
        seen = circle.center_mm + times * (picture.true_center_mm - circle.center_mm)
        label = f"true centre, its distance × {times:g}"
        axes.plot(*seen, "x", color=TRUTH_COLOR, ms=6, ls="none", label=label)
    _draw_contacts(axes, picture, circle)


def _draw_contacts(axes: Axes, picture: HolePicture, circle: Circle) -> None:
    times = picture.residual_factor
    wall = _on_wall(circle, picture.reading_mm, times)
    foot = _on_wall(circle, picture.reading_mm, 0.0)
    label = f"contacts, residual × {times:g}"
    axes.plot(*wall.T, ".", color=CONTACT_COLOR, ms=6, ls="none", label=label)
    for end, point in zip(foot, wall, strict=True):
        axes.plot(*np.stack([end, point]).T, color=CONTACT_COLOR, lw=0.7)


def _fitting(size_mm: float, room_mm: float) -> float:
    return max((one for one in FACTORS if one * size_mm <= room_mm), default=FACTORS[0])


def _on_wall(circle: Circle, reading_mm: FloatArray, times: float) -> FloatArray:
    """Return where the contacts lie on the wall ``(n, 2)``, off it by their residuals, mm."""
    away = reading_mm - circle.center_mm
    length = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), np.finfo(float).tiny)
    distance = circle.radius_mm + times * circle.residual_mm
    return circle.center_mm + distance[:, None] * away / length


def _region(circle: Circle, times: float, label: str) -> Ellipse:
    value, vector = np.linalg.eigh(circle.covariance_mm2[:2, :2])
    width, height = 2.0 * times * np.sqrt(PLANE_REGION * value)
    turn = float(np.degrees(np.arctan2(vector[1, 0], vector[0, 0])))
    x, y = circle.center_mm
    return Ellipse(
        (float(x), float(y)), width, height, angle=turn, fc=ESTIMATE_COLOR, alpha=0.3, label=label
    )


def _ring(center_mm: FloatArray, radius_mm: float, color: str, width: float) -> Disc:
    x, y = center_mm
    return Disc((float(x), float(y)), radius_mm, fill=False, ec=color, lw=width)
