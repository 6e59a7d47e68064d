"""The picture of a hole: estimate, contacts, and the confidence ellipse of the centre.

Errors of some hundredths of a millimetre are not visible beside a radius of millimetres. Residuals,
ellipse and the distance of the true centre are therefore magnified by the factors in the legend.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from spikingtac.geometry.hole import Circle
from spikingtac.plots.theme import Theme, new_figure, style_axes
from spikingtac.plots.tracks import save_figure
from spikingtac.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Ellipse

PLANE_REGION = 5.991  # 95 % quantile of chi-squared with two degrees of freedom: the centre alone.

# Possible magnifications; the largest that fits is taken.
FACTORS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)

# Largest size of ellipse and residuals as a fraction of the radius.
CENTER_FRACTION, RESIDUAL_FRACTION = 0.5, 0.25
HALF_WIDTH = 1.3  # Half the picture's width, in radii: the residuals need room outside.

# Line widths: the estimate is a thin line over the broad one of the truth.
TRUTH_WIDTH, ESTIMATE_WIDTH = 3.0, 1.2
HEIGHT = 1.2  # Height of the figure over its width: the legend stands below.


@dataclass(frozen=True, kw_only=True)
class HolePicture:
    """The content of the picture of one hole.

    Attributes:
        circle: The estimate; its residuals belong to the readings.
        reading_mm: ``(n, 2)`` the arm's positions at the decisions, mm.
        true_center_mm: ``(2,)`` mm, where it is known.
        true_radius_mm: The same of the radius, mm.
    """

    circle: Circle
    reading_mm: FloatArray
    true_center_mm: FloatArray | None = None
    true_radius_mm: float | None = None

    @property
    def error_mm(self) -> FloatArray | None:
        """Errors ``(3,)`` of centre x, centre y and radius, mm; None without a truth."""
        if self.true_center_mm is None or self.true_radius_mm is None:
            return None
        away_mm = self.circle.center_mm - self.true_center_mm
        return np.append(away_mm, self.circle.radius_mm - self.true_radius_mm)

    @property
    def center_factor(self) -> float:
        """Magnification of ellipse and true centre, one of :data:`FACTORS`."""
        largest_mm2 = np.linalg.eigvalsh(self.circle.covariance_mm2[:2, :2])[-1]
        size_mm = float(np.sqrt(PLANE_REGION * largest_mm2))
        if self.error_mm is not None:
            size_mm = max(size_mm, float(np.linalg.norm(self.error_mm[:2])))
        return _fitting(size_mm, CENTER_FRACTION * self.circle.radius_mm)

    @property
    def residual_factor(self) -> float:
        """Magnification of the residuals, one of :data:`FACTORS`."""
        size_mm = float(np.abs(self.circle.residual_mm).max(initial=0.0))
        return _fitting(size_mm, RESIDUAL_FRACTION * self.circle.radius_mm)


def _fitting(size_mm: float, room_mm: float) -> float:
    return max((one for one in FACTORS if one * size_mm <= room_mm), default=FACTORS[0])


def save_hole_plot(path: str | Path, title: str, picture: HolePicture) -> None:
    """Write the picture of one hole.

    Args:
        path: PNG, SVG or PDF file.
        title: Above it; says whether it is simulated.
        picture: What was found.
    """
    figure, theme = new_figure("light", "double", HEIGHT)
    axes = figure.add_subplot()
    style_axes(axes, theme)
    draw_hole(axes, picture, theme)
    axes.set(xlabel="x of the arm (mm)", ylabel="y of the arm (mm)")
    axes.grid(alpha=0.25)
    figure.suptitle(title, fontsize=9)
    names = axes.get_legend_handles_labels()
    figure.legend(*names, loc="outside lower center", ncols=2, fontsize=8)
    save_figure(figure, path)


def draw_hole(axes: Axes, picture: HolePicture, theme: Theme) -> None:
    """Draw truth, estimate, contacts and confidence ellipse, to equal scale, with their labels."""
    from matplotlib.patches import Circle as Disc

    circle, times = picture.circle, picture.center_factor
    rings = [(circle.center_mm, circle.radius_mm, "estimate", theme.strong, ESTIMATE_WIDTH, 1.0)]
    if picture.true_center_mm is not None and picture.true_radius_mm is not None:
        truth = (picture.true_center_mm, picture.true_radius_mm)
        rings.append((*truth, "true hole", theme.second, TRUTH_WIDTH, 0.35))
        seen = circle.center_mm + times * (picture.true_center_mm - circle.center_mm)
        label = f"true centre, its distance × {times:g}"
        axes.plot(*seen, "x", color=theme.second, ms=6, ls="none", label=label)
    for center_mm, radius_mm, name, color, width, alpha in rings:
        x, y = (float(value) for value in center_mm)
        label = f"{name}, R {radius_mm:.3f} mm"
        axes.add_patch(
            Disc((x, y), radius_mm, fill=False, ec=color, lw=width, alpha=alpha, label=label)
        )
    axes.plot(*circle.center_mm, "+", color=theme.strong, ms=8, ls="none", label="estimated centre")
    label = f"95 % region of the centre × {times:g}"
    axes.add_patch(_region(circle, times, theme.strong, label))
    _draw_contacts(axes, picture, theme)
    middle_mm, radius_mm = rings[-1][:2]
    x, y, half = float(middle_mm[0]), float(middle_mm[1]), HALF_WIDTH * radius_mm
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")


def _draw_contacts(axes: Axes, picture: HolePicture, theme: Theme) -> None:
    """Draw the contacts on the wall, off it by their residuals."""
    circle, times = picture.circle, picture.residual_factor
    away = picture.reading_mm - circle.center_mm
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), np.finfo(float).tiny)
    foot = circle.center_mm + circle.radius_mm * away
    wall = foot + times * circle.residual_mm[:, None] * away
    label = f"contacts, residual × {times:g}"
    axes.plot(*wall.T, ".", color=theme.text, ms=6, ls="none", label=label)
    axes.plot(*np.stack([foot, wall]).transpose(2, 0, 1), color=theme.text, lw=0.7)


def _region(circle: Circle, times: float, color: str, label: str) -> Ellipse:
    from matplotlib.patches import Ellipse

    value, vector = np.linalg.eigh(circle.covariance_mm2[:2, :2])
    width, height = 2.0 * times * np.sqrt(PLANE_REGION * value)
    turn = float(np.degrees(np.arctan2(vector[1, 0], vector[0, 0])))
    x, y = (float(value) for value in circle.center_mm)
    return Ellipse((x, y), width, height, angle=turn, fc=color, alpha=0.3, label=label)
