"""The summary picture of a tracked recording: one moment, and the time courses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ON_COLOR, OFF_COLOR = "#6fb3e0", "#d98a5b"
ARROW_COLOR, TRUTH_COLOR, CONTACT_COLOR = "#e9b44c", "#6cc28a", "#ffd479"
GROUND, PANEL, TEXT, SOFT = "#0b0d0e", "#161a1d", "#dbe0e3", "#8d979e"
WIDTH_IN, HEIGHT_IN, DPI = 10.0, 5.6, 130
PICTURE_ENDINGS = (".png", ".svg", ".pdf")
CREATOR = "spikingtac summary"
"""Creator field in the metadata of the picture."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One moment of a sensor.

    Attributes:
        image: ``(height, width)`` codes: 0 nothing, 1 an ON event, 2 an OFF event.
        reference_px: ``(m, 2)`` rest positions, px.
        position_px: ``(m, 2)`` positions, px.
        radius_px: ``(m,)`` radii of the markers, px.
        t_s: Its time, s.
    """

    image: NDArray[np.uint8]
    reference_px: NDArray[np.floating]
    position_px: NDArray[np.floating]
    radius_px: NDArray[np.floating]
    t_s: float


@dataclass(frozen=True, kw_only=True)
class Course:
    """The quantities over time.

    Attributes:
        t_s: ``(n,)`` times, s.
        displacement_px: ``(n, m)`` length of each marker's displacement, px.
        rate_kev_s: ``(n,)`` event rate, thousands per second.
        contacts_s: Beginnings of contacts, s.
    """

    t_s: NDArray[np.floating]
    displacement_px: NDArray[np.floating]
    rate_kev_s: NDArray[np.floating]
    contacts_s: tuple[float, ...] = ()


def save_summary(
    path: str | Path, title: str, picture: Picture, course: Course, arrow_scale: float = 2.0
) -> None:
    """Write a picture of a tracked recording: the sensor at one moment beside the whole course.

    Args:
        path: PNG, SVG or PDF file.
        title: One line above it.
        picture: The moment.
        course: The whole.
        arrow_scale: Length of the arrows per displacement.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DPI, facecolor=PANEL, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1))
    sensor, above, below = (
        figure.add_subplot(grid[:, 0]),
        figure.add_subplot(grid[0, 1]),
        figure.add_subplot(grid[1, 1]),
    )
    draw_sensor(sensor, picture, arrow_scale)
    _draw_course(above, below, course, picture.t_s)
    figure.suptitle(title, color=TEXT, fontsize=11)
    with replacing(path) as partial:
        figure.savefig(partial, facecolor=PANEL, metadata={"Creator": CREATOR})


def draw_sensor(axes: Axes, picture: Picture, arrow_scale: float = 2.0) -> None:
    """Draw events, resting discs and displacement arrows as the page does."""
    from matplotlib.colors import ListedColormap

    height, width = picture.image.shape
    colors = ListedColormap([GROUND, ON_COLOR, OFF_COLOR])
    axes.imshow(picture.image, cmap=colors, vmin=0, vmax=2, interpolation="nearest")
    for (x, y), radius in zip(picture.reference_px, picture.radius_px, strict=True):
        ring: Any = _circle(x, y, radius)
        axes.add_patch(ring)
    moved = (picture.position_px - picture.reference_px) * arrow_scale
    axes.quiver(
        *picture.reference_px.T,
        *moved.T,
        color=ARROW_COLOR,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.004,
        headwidth=4.5,
    )
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])
    label = f"t = {picture.t_s:.3f} s, arrows × {arrow_scale:g}"
    axes.set_xlabel(label, color=SOFT, fontsize=8)


def _circle(x: float, y: float, radius: float) -> Any:
    from matplotlib.patches import Circle

    return Circle((x, y), radius, fill=False, edgecolor="#4b545b", linewidth=0.7)


def _draw_course(above: Axes, below: Axes, course: Course, now_s: float) -> None:
    above.plot(course.t_s, course.rate_kev_s, color=ON_COLOR, linewidth=0.9)
    above.set_ylabel("events, thousands per s", color=SOFT, fontsize=8)
    below.plot(course.t_s, course.displacement_px, color=ARROW_COLOR, linewidth=0.5, alpha=0.35)
    below.set_ylabel("displacement of each marker, px", color=SOFT, fontsize=8)
    below.set_xlabel("time, s", color=SOFT, fontsize=8)
    for axes in (above, below):
        axes.set_facecolor(GROUND)
        axes.tick_params(colors=SOFT, labelsize=7)
        for spine in axes.spines.values():
            spine.set_color("#272d32")
        axes.axvline(now_s, color=TEXT, linewidth=0.6)
        for at_s in course.contacts_s:
            axes.axvline(at_s, color=CONTACT_COLOR, linewidth=0.7, linestyle=":")
