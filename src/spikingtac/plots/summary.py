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
ARROW_COLOR, CONTACT_COLOR = "#e9b44c", "#ffd479"
GROUND, PANEL, TEXT, SOFT = "#0b0d0e", "#161a1d", "#dbe0e3", "#8d979e"
RING_COLOR = "#4b545b"
WIDTH_IN, HEIGHT_IN, DPI = 10.0, 5.6, 130
CREATOR = "spikingtac summary"  # Creator field in the metadata of the picture.


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
    panels = figure.subplot_mosaic("sa;sb", width_ratios=(1.25, 1))
    SensorDrawing(panels["s"], picture, arrow_scale)
    _draw_course(panels["a"], panels["b"], course, picture.t_s)
    figure.suptitle(title, color=TEXT, fontsize=11)
    with replacing(path) as partial:
        figure.savefig(partial, facecolor=PANEL, metadata={"Creator": CREATOR})


class SensorDrawing:
    """Events, resting discs and displacement arrows, drawn as the page does, moment by moment.

    Args:
        axes: Where to draw.
        picture: The first moment.
        arrow_scale: Length of the arrows per displacement.
    """

    def __init__(self, axes: Axes, picture: Picture, arrow_scale: float = 2.0) -> None:
        from matplotlib.collections import EllipseCollection
        from matplotlib.colors import ListedColormap

        self._axes, self._scale = axes, arrow_scale
        colors = ListedColormap([GROUND, ON_COLOR, OFF_COLOR])
        height, width = picture.image.shape
        self._events = axes.imshow(
            picture.image, cmap=colors, vmin=0, vmax=2, interpolation="nearest"
        )
        across_px = 2.0 * np.asarray(picture.radius_px)
        rings = EllipseCollection(across_px, across_px, np.zeros(len(across_px)), units="xy")
        rings.set(offsets=picture.reference_px, offset_transform=axes.transData)
        rings.set(facecolors="none", edgecolors=RING_COLOR, linewidths=0.7)
        axes.add_collection(rings)
        rest_px, moved_px = picture.reference_px.T, self._moved(picture).T
        look: dict[str, Any] = {"color": ARROW_COLOR, "width": 0.004, "headwidth": 4.5}
        in_px: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1}
        self._arrows = axes.quiver(*rest_px, *moved_px, **look, **in_px)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])
        self.show(picture)

    def show(self, picture: Picture) -> None:
        """Draw another moment of the same sensor."""
        self._events.set_data(picture.image)
        self._arrows.set_UVC(*self._moved(picture).T)
        label = f"t = {picture.t_s:.3f} s, arrows × {self._scale:g}"
        self._axes.set_xlabel(label, color=SOFT, fontsize=8)

    def _moved(self, picture: Picture) -> NDArray[np.floating]:
        return (picture.position_px - picture.reference_px) * self._scale


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
