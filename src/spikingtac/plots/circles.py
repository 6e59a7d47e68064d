"""Pictures of circles and what is known of them: a calibration's markers, and a probed hole.

Errors of some hundredths of a millimetre are not visible beside a hole's radius of millimetres.
Residuals, ellipse and the distance of the true centre are therefore magnified by the factors in the
legend.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import EDGE_DEFAULT_PX, covered, nearest_rims
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.plots.figure import Theme, new_figure, save_figure, style_axes
from spikingtac.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from spikingtac.geometry.hole import Circle  # its solver takes verbs 0.2 s to start

MARGIN = 0.09  # Height of a calibration's title and legend over the figure's width.

# Colour and line of a marker's circle, by what is known of it; told apart by deuteranopes, too
# (Okabe and Ito, 2008).
STATUS: dict[str, tuple[str, Literal["-", "--"]]] = {
    "good": ("#009e73", "-"),
    "doubtful": ("#e69f00", "-"),
    "expected": ("#cc79a7", "--"),
}

LEVELS = {"white": (0.15, 0.85), "dark": (0.85, 0.15)}  # Grey of the ground and of the markers.

PLANE_REGION = 5.991  # 95 % quantile of chi-squared with two degrees of freedom: the centre alone.

# Possible magnifications; the largest that fits is taken.
FACTORS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)

# Largest size of ellipse and residuals as a fraction of the radius.
CENTER_FRACTION, RESIDUAL_FRACTION = 0.5, 0.25
HALF_WIDTH = 1.3  # Half the picture's width, in radii: the residuals need room outside.

# Line widths: the estimate is a thin line over the broad one of the truth.
TRUTH_WIDTH, ESTIMATE_WIDTH = 3.0, 1.2
HEIGHT = 1.2  # Height of the figure of a hole over its width: the legend stands below.


def save_calibration_plot(calibration: Calibration, path: str | Path) -> None:
    """Draw the markers as they look and circles around them, and write the picture.

    Args:
        calibration: What to draw.
        path: File to write; its ending chooses the format.
    """
    from matplotlib.lines import Line2D

    width, height = calibration.size
    figure, theme = new_figure("light", "double", height / width + MARGIN)
    axes = figure.add_subplot()
    style_axes(axes, theme)
    axes.imshow(_picture(calibration), cmap="gray", vmin=0.0, vmax=1.0)
    # How well each marker is known, then its ring and number in that colour.
    notes, measured = calibration.provenance, calibration.marker_measured
    missing = notes.get("missing", []) if measured is None else np.flatnonzero(~measured).tolist()
    status = ["good"] * len(calibration.radius_px)
    for name, markers in (("doubtful", notes.get("doubtful", [])), ("expected", missing)):
        for marker in markers:
            status[marker] = name
    for marker, center in enumerate(calibration.reference_px):
        color, line = STATUS[status[marker]]
        radius_px = float(calibration.radius_px[marker])
        _draw_ring(axes, center, radius_px, color=color, linestyle=line, linewidth=1.6)
        axes.annotate(str(marker), tuple(center), color=color, ha="center", va="center", size=7)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="x (px)", ylabel="y (px)")
    axes.set_aspect("equal")
    shape = "x".join(map(str, calibration.grid or ("free",)))
    said = notes.get("quality")
    axes.set_title(
        f"{shape} {calibration.polarity} markers, radius "
        f"{float(np.mean(calibration.radius_px)):.2f} px" + (f", quality {said}" if said else "")
    )
    handles = [
        Line2D([], [], color=color, linestyle=line, label=f"{name}: {status.count(name)}")
        for name, (color, line) in STATUS.items()
        if name in status
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    save_figure(figure, path)


def _picture(calibration: Calibration) -> FloatArray:
    """Return ``(height, width)`` grey levels 0 to 1 of the sensor as its calibration has it."""
    owner, _, q_px = nearest_rims(calibration)
    cover = covered(q_px / calibration.of_each_marker("edge_px", EDGE_DEFAULT_PX)[owner])
    ground, marker_level = LEVELS[calibration.polarity]
    return ground + (marker_level - ground) * cover


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
        return self._fitting(size_mm, CENTER_FRACTION)

    @property
    def residual_factor(self) -> float:
        """Magnification of the residuals, one of :data:`FACTORS`."""
        return self._fitting(
            float(np.abs(self.circle.residual_mm).max(initial=0.0)), RESIDUAL_FRACTION
        )

    def _fitting(self, size_mm: float, share: float) -> float:
        room_mm = share * self.circle.radius_mm
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
    from matplotlib.patches import Ellipse

    circle, times = picture.circle, picture.center_factor
    center_mm, radius_mm = circle.center_mm, circle.radius_mm
    label = f"estimate, R {radius_mm:.3f} mm"
    _draw_ring(axes, center_mm, radius_mm, ec=theme.strong, lw=ESTIMATE_WIDTH, label=label)
    axes.plot(*center_mm, "+", color=theme.strong, ms=8, ls="none", label="estimated centre")
    if picture.true_center_mm is not None and picture.true_radius_mm is not None:
        seen = center_mm + times * (picture.true_center_mm - center_mm)
        label = f"true centre, its distance × {times:g}"
        axes.plot(*seen, "x", color=theme.second, ms=6, ls="none", label=label)
        center_mm, radius_mm = picture.true_center_mm, picture.true_radius_mm
        look = {"ec": theme.second, "lw": TRUTH_WIDTH, "alpha": 0.35}
        _draw_ring(axes, center_mm, radius_mm, label=f"true hole, R {radius_mm:.3f} mm", **look)
    value, vector = np.linalg.eigh(circle.covariance_mm2[:2, :2])
    sides_mm = 2.0 * times * np.sqrt(PLANE_REGION * value)
    look = {"fc": theme.strong, "alpha": 0.3, "label": f"95 % region of the centre × {times:g}"}
    turn = float(np.degrees(np.arctan2(vector[1, 0], vector[0, 0])))
    axes.add_patch(Ellipse(tuple(circle.center_mm), *sides_mm, angle=turn, **look))
    # Contacts stand on the wall, off it by their residuals.
    away = picture.reading_mm - circle.center_mm
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), np.finfo(float).tiny)
    foot = circle.center_mm + circle.radius_mm * away
    wall = foot + picture.residual_factor * circle.residual_mm[:, None] * away
    label = f"contacts, residual × {picture.residual_factor:g}"
    axes.plot(*wall.T, ".", color=theme.text, ms=6, ls="none", label=label)
    axes.plot(*np.stack([foot, wall]).transpose(2, 0, 1), color=theme.text, lw=0.7)
    x, y, half = float(center_mm[0]), float(center_mm[1]), HALF_WIDTH * radius_mm
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")


def _draw_ring(axes: Axes, center: NDArray[np.floating], radius: float, **look: object) -> None:
    from matplotlib.patches import Circle as Disc

    x, y = (float(value) for value in center)
    axes.add_patch(Disc((x, y), radius, fill=False, **look))  # type: ignore[arg-type]
