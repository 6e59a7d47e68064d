"""Moments of a sensor: the summary picture of a view, and tracks as an animated GIF."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing, require_free
from spikingtac.errors import ConfigError
from spikingtac.plots.figure import THEMES, drawn, new_figure, save_gif, style_axes
from spikingtac.plots.tracks import draw_course, draw_field, require_estimates, turn_arrows, view_px
from spikingtac.tracks import Tracks
from spikingtac.types import US_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

DARK = THEMES["dark"]
ARROW_COLOR, CONTACT_COLOR = "#e9b44c", "#ffd479"
GROUND, PANEL, TEXT, SOFT = "#0b0d0e", "#161a1d", "#dbe0e3", "#8d979e"
RING_COLOR = "#4b545b"
WIDTH_IN, HEIGHT_IN, DPI = 10.0, 5.6, 130
ARROW_SCALE = 2.0  # Length of the arrows per displacement.
CREATOR = "spikingtac summary"  # Creator field in the metadata of the picture.

# Twenty pictures per second: GIF counts in 10 ms, and browsers slow down what is below 20 ms.
FRAME_MS = 50
MOST_PICTURES = 600  # Half a minute; more would take megabytes and minutes.
MOST_COLORS = 64
SCREEN_DPI = 120  # Dots per inch: 420 px for one column.

# Width of the field without its scale, height of the course, and what titles and labels take:
# over the figure's width.
FIELD_WIDTH, COURSE_HEIGHT, AROUND = 0.67, 0.24, 0.44
COURSE_POINTS = 800  # Estimates of the course that are drawn: two a pixel.

# Shown before and after the largest displacement where no stretch was given, us.
AROUND_US = 1_000_000


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


class Moment(NamedTuple):
    """The quantities of one time.

    Attributes:
        t_s: The time, s.
        rate_kev_s: Event rate, thousands per second.
        moved_px: ``(m,)`` length of each marker's displacement, px.
        error_px: ``(m,)`` distance of each marker from its true place, px; None without a truth.
    """

    t_s: float
    rate_kev_s: float
    moved_px: NDArray[np.float32]
    error_px: NDArray[np.float32] | None


def save_summary(
    path: str | Path,
    title: str,
    picture: Picture,
    course: Sequence[Moment],
    contacts_s: Iterable[float],
) -> None:
    """Write a picture of a tracked recording: the sensor at one moment beside the whole course.

    Args:
        path: PNG, SVG or PDF file.
        title: One line above it.
        picture: The moment.
        course: The whole.
        contacts_s: Beginnings of contacts, s.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DPI, facecolor=PANEL, layout="constrained")
    # Events alone have no displacement.
    layout = "sa;sb" if len(picture.reference_px) else "sa"
    sensor, above, *below = figure.subplot_mosaic(layout, width_ratios=(1.25, 1)).values()
    SensorDrawing(sensor, picture)
    t_s = [moment.t_s for moment in course]
    above.plot(t_s, [moment.rate_kev_s for moment in course], color=DARK.on, linewidth=0.9)
    above.set_ylabel("events, thousands per s", color=SOFT, fontsize=8)
    for axes in below:
        moved_px = np.array([moment.moved_px for moment in course])
        axes.plot(t_s, moved_px, color=ARROW_COLOR, linewidth=0.5, alpha=0.35)
        axes.set_ylabel("displacement of each marker, px", color=SOFT, fontsize=8)
    courses = [above, *below]
    courses[-1].set_xlabel("time, s", color=SOFT, fontsize=8)
    for axes in courses:
        axes.set_facecolor(GROUND)
        axes.tick_params(colors=SOFT, labelsize=7)
        for spine in axes.spines.values():
            spine.set_color("#272d32")
        axes.axvline(picture.t_s, color=TEXT, linewidth=0.6)
        for at_s in contacts_s:
            axes.axvline(at_s, color=CONTACT_COLOR, linewidth=0.7, linestyle=":")
    figure.suptitle(title, color=TEXT, fontsize=11)
    with replacing(path) as partial:
        figure.savefig(partial, facecolor=PANEL, metadata={"Creator": CREATOR})


class SensorDrawing:
    """Events, resting discs and displacement arrows, drawn as the page does, moment by moment.

    Args:
        axes: Where to draw.
        picture: The first moment.
    """

    def __init__(self, axes: Axes, picture: Picture) -> None:
        from matplotlib.collections import EllipseCollection
        from matplotlib.colors import ListedColormap

        self._axes = axes
        colors = ListedColormap([GROUND, DARK.on, DARK.off])
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
        label = f"t = {picture.t_s:.3f} s"
        label += f", arrows × {ARROW_SCALE:g}" if len(picture.reference_px) else ""
        self._axes.set_xlabel(label, color=SOFT, fontsize=8)

    def _moved(self, picture: Picture) -> NDArray[np.floating]:
        return (picture.position_px - picture.reference_px) * ARROW_SCALE


def save_animation(
    tracks: Tracks,
    path: str | Path,
    *,
    stretch_s: tuple[float | None, float | None] = (None, None),
    slow: float = 1.0,
    theme: str = "light",
    width: str = "single",
) -> int:
    """Write an animation; return its number of pictures.

    Arrows and colours keep their scale, so that pictures can be compared. All of the tracks stands
    below, the stretch is a line that moves through it.

    Args:
        tracks: What is drawn; in mm where its scale is known, otherwise in px.
        path: File to write, ``.gif``; it appears whole or not at all.
        stretch_s: Begin and end, s since the first estimate; a second before and after the largest
            displacement unless given.
        slow: How many times slower than it was; below 1 it is faster.
        theme: ``light`` or ``dark``.
        width: ``single`` or ``double`` column.

    Raises:
        ConfigError: A name, the ending or the stretch makes no sense, or nothing was tracked.
    """
    require_free(path, True, (".gif",))
    require_estimates(tracks)
    rows = _rows(tracks, stretch_s, slow)
    pictures = _pictures(tracks, rows, theme, width)
    with replacing(path) as partial:
        save_gif(pictures, FRAME_MS, partial)
    return len(rows)


def _rows(tracks: Tracks, stretch_s: tuple[float | None, float | None], slow: float) -> list[int]:
    """Return the estimates to draw."""
    if not slow > 0.0:
        raise ConfigError(f"slow is {slow:g}, it must be above 0; 4 is four times slower")
    begin_us, end_us = int(tracks.t_us[0]), int(tracks.t_us[-1])
    largest_us = int(tracks.summary()["displacement_max_t_us"])
    usual_us = max(largest_us - AROUND_US, begin_us), min(largest_us + AROUND_US, end_us)
    first_us, last_us = (
        usual if given is None else begin_us + round(given * US_PER_S)
        for given, usual in zip(stretch_s, usual_us, strict=True)
    )
    if not begin_us <= first_us < last_us <= end_us:
        shown = ((t - begin_us) / US_PER_S for t in (first_us, last_us, end_us))
        raise ConfigError(
            "cannot animate from {:g} to {:g} s: the tracks go from 0 to {:g} s, and an animation "
            "ends after it begins".format(*shown)
        )
    every_us = FRAME_MS * 1_000 / slow
    pictures = 1 + (last_us - first_us) // every_us
    if pictures > MOST_PICTURES:
        raise ConfigError(
            f"this animation would have {pictures:.0f} pictures, {MOST_PICTURES} at most; take a "
            "shorter stretch, or show it faster"
        )
    times = np.arange(first_us, last_us + 1, every_us)
    return np.searchsorted(tracks.t_us, times).clip(0, len(tracks.t_us) - 1).tolist()


def _pictures(tracks: Tracks, rows: list[int], theme: str, width: str) -> list[Image]:
    """Draw the largest displacement of the stretch, then turn its arrows for each picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    low, high = view_px(tracks.reference_px)
    field = FIELD_WIDTH * float((high[1] - low[1]) / (high[0] - low[0]))
    figure, colors = new_figure(theme, width, field + COURSE_HEIGHT + AROUND)
    figure.set_dpi(SCREEN_DPI)
    canvas = FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, height_ratios=(field, COURSE_HEIGHT))
    for axes in (upper, lower):
        style_axes(axes, colors)
    length = np.hypot(*np.moveaxis(tracks.displacement_px[rows], 2, 0)).max(axis=1)
    arrows, gain = draw_field(upper, tracks, rows[int(length.argmax())], colors)
    draw_course(lower, tracks, colors, COURSE_POINTS)
    now = lower.axvline(0.0, color=colors.text, linewidth=0.8)
    canvas.draw()
    figure.set_layout_engine("none")  # as it was found once: nothing jumps
    shown = []
    for row in rows:
        t_s = (int(tracks.t_us[row]) - int(tracks.t_us[0])) / US_PER_S
        turn_arrows(arrows, tracks, row, gain)
        upper.title.set_text(f"t = {t_s:.2f} s, arrows × {gain:.2g}")
        now.set_xdata([t_s, t_s])
        shown.append(drawn(canvas, MOST_COLORS))
    return shown
