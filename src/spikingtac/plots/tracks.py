"""Figures of tracks: displacement over time, vector field, heat map, strain."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.lens import marker_pitch_px
from spikingtac.errors import ConfigError, named, require_type
from spikingtac.plots.figure import FONT_PT, PAD_IN, Theme, legend_above, new_figure, style_axes
from spikingtac.touch.field import GradientOperator
from spikingtac.tracks import Tracks
from spikingtac.tracks.comparison import LOADED, Comparison
from spikingtac.types import US_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.quiver import Quiver

Kind = Literal["course", "field", "map", "strain"]
MOST_TICKS = 6  # Most intervals between the ticks of an axis of a field.
ARROW_SHARE = 0.9  # Length of the longest arrow over the distance of neighbouring markers.
STRAIN_COLORS = "RdBu_r"  # Colour map of the growth of area, whose sign counts.

# Free space around the markers of a field, px: about half a pitch of the usual grids.
MARGIN_PX = 20.0
TIP_PX = 2.0  # Free space around the tip of an arrow, px.

# Height of a time course, the largest of a field with its scale, and that of a comparison, over
# the width.
COURSE_HEIGHT, FIELD_HEIGHT, COMPARISON_HEIGHT = 0.62, 1.3, 1.05


def plot_tracks(
    tracks: Tracks,
    kind: str = "course",
    *,
    at_us: int | None = None,
    theme: str = "light",
    width: str = "single",
) -> Figure:
    """Draw tracks.

    Args:
        tracks: What is drawn; in mm where its scale is known, otherwise in px.
        kind: ``course`` (displacement of every marker over time), ``field`` (arrows), ``map``
            (length of the displacement) or ``strain`` (growth of area).
        at_us: Time of a field, map or strain, us; that of the largest displacement unless given.
        theme: ``light`` or ``dark``.
        width: ``single`` or ``double`` column.

    Raises:
        ConfigError: A name is unknown, the time is not in the tracks, there is nothing to draw, or
            no tracks are given, but a path.
    """
    require_type(tracks, Tracks, LOADED)
    draws = {
        "course": None,
        "field": draw_field,
        "map": partial(_draw_squares, strain=False),
        "strain": partial(_draw_squares, strain=True),
    }
    draw = named(draws, kind, "kind of plot")
    require_estimates(tracks)
    figure, colors = new_figure(theme, width, COURSE_HEIGHT if draw is None else FIELD_HEIGHT)
    axes = figure.add_subplot()
    style_axes(axes, colors)
    if draw is None:
        draw_course(axes, tracks, colors)
        legend_above(axes, colors)
        return figure
    draw(axes, tracks, _row(tracks, at_us), colors)
    # What is empty above and below goes: an image's aspect leaves room in its figure.
    figure.draw_without_rendering()
    wide_in, high_in = figure.get_size_inches()
    figure.set_size_inches(wide_in, min(figure.get_tightbbox().height + 2.0 * PAD_IN, high_in))
    return figure


def require_estimates(tracks: Tracks) -> None:
    """Raise ConfigError where there is nothing to draw."""
    if not len(tracks.t_us):
        raise ConfigError("these tracks hold no estimate; there is nothing to draw")


def _row(tracks: Tracks, at_us: int | None) -> int:
    begin_us, end_us = int(tracks.t_us[0]), int(tracks.t_us[-1])
    if at_us is not None and not begin_us <= at_us <= end_us:
        asked_s, lasts_s = ((t_us - begin_us) / US_PER_S for t_us in (at_us, end_us))
        raise ConfigError(
            f"nothing was tracked at {asked_s:g} s; the tracks go from 0 to {lasts_s:g} s"
        )
    chosen_us = tracks.summary()["displacement_max_t_us"] if at_us is None else at_us
    return int(np.abs(tracks.t_us - int(chosen_us)).argmin())


def _moved(tracks: Tracks) -> tuple[NDArray[np.floating], str]:
    """Return the displacements ``(n, m, 2)`` and their unit."""
    if tracks.px_per_mm is None:
        return tracks.displacement_px, "px"
    return tracks.displacement_mm, "mm"


def draw_course(axes: Axes, tracks: Tracks, theme: Theme, most_points: int | None = None) -> None:
    """Draw the length of every marker's displacement over time.

    Args:
        axes: Where to draw.
        tracks: What to draw.
        theme: Colours.
        most_points: Most estimates that are drawn, for animations; all unless given.
    """
    moved, unit = _moved(tracks)
    count = len(tracks.t_us)
    some = slice(None, None, max(count // (most_points or count), 1))
    length = np.hypot(moved[some, :, 0], moved[some, :, 1])
    t_s = (tracks.t_us[some] - tracks.t_us[0]) / US_PER_S
    labels = ["each marker", *["_"] * (length.shape[1] - 1)]  # "_" names nothing
    axes.plot(t_s, length, color=theme.soft, linewidth=0.3, alpha=0.6, label=labels)
    axes.plot(t_s, np.median(length, axis=1), color=theme.second, linewidth=1.0, label="median")
    axes.plot(t_s, length.max(axis=1), color=theme.strong, linewidth=1.0, label="largest")
    axes.set(xlabel="time (s)", ylabel=f"displacement ({unit})", xlim=(t_s[0], max(t_s[-1], 1e-6)))


def pitch_px(rest: NDArray[np.floating]) -> float:
    """Return the median distance of the nearest neighbour, px."""
    return marker_pitch_px(rest.astype(np.float64)) if len(rest) > 1 else MARGIN_PX


def view_px(rest_px: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the upper left and the lower right corner of the view of markers, px."""
    margin = max(MARGIN_PX, 0.6 * pitch_px(rest_px))
    return rest_px.min(axis=0) - margin, rest_px.max(axis=0) + margin


def turn_arrows(quiver: Quiver, tracks: Tracks, row: int, gain: float) -> None:
    """Show the displacements of an estimate by the arrows of a field, ``gain`` times as long."""
    x, y = tracks.displacement_px[row].T
    quiver.set_UVC(gain * x, gain * y, np.hypot(x, y) / (tracks.px_per_mm or 1.0))


def draw_field(axes: Axes, tracks: Tracks, row: int, theme: Theme) -> tuple[Quiver, float]:
    """Draw the displacements of an estimate as arrows; return them and their gain.

    Args:
        axes: Where to draw.
        tracks: Whose estimate.
        row: Which one; its longest arrow sets the scale.
        theme: Colours.
    """
    rest, moved_px = tracks.reference_px, tracks.displacement_px[row]
    longest_px = max(float(np.hypot(*moved_px.T).max()), 1e-9)
    none = np.zeros(len(rest))
    quiver = axes.quiver(
        *rest.T, none, none, none,
        cmap=theme.magnitudes(), angles="xy", scale_units="xy", scale=1, width=0.006,
    )  # fmt: skip
    gain = ARROW_SHARE * pitch_px(rest) / longest_px
    turn_arrows(quiver, tracks, row, gain)
    quiver.set_clim(0.0, longest_px / (tracks.px_per_mm or 1.0))
    axes.plot(*rest.T, ".", color=theme.soft, markersize=1.5, zorder=0)
    _finish_field(axes, tracks, row, theme, rest + gain * moved_px)
    axes.set_title(f"{axes.get_title()}, arrows × {gain:.2g}", color=theme.text, fontsize=FONT_PT)
    _add_scale(axes, quiver, f"displacement ({_moved(tracks)[1]})", theme)
    return quiver, gain


def _draw_squares(axes: Axes, tracks: Tracks, row: int, theme: Theme, *, strain: bool) -> None:
    """Draw displacement, or growth of area, as squares as wide as markers are apart."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    if strain:
        operator = GradientOperator(tracks.reference_px.astype(np.float64))
        slopes = operator.slopes(tracks.displacement_px[row].astype(np.float64))
        values = 100.0 * np.trace(slopes, axis1=1, axis2=2)
        bound = max(float(np.abs(values).max()), 1e-9)
        colors, limits, label = STRAIN_COLORS, (-bound, bound), "growth of area (%)"
    else:
        moved, unit = _moved(tracks)
        values = np.hypot(*moved[row].T)
        colors, limits = theme.magnitudes(), (0.0, float(values.max()))
        label = f"displacement ({unit})"
    pitch = pitch_px(tracks.reference_px)
    corners = (tracks.reference_px - pitch / 2).astype(float)
    squares = [Rectangle((x, y), pitch, pitch) for x, y in corners]
    tiles = PatchCollection(squares, cmap=colors, linewidth=0)
    tiles.set_array(values)
    tiles.set_clim(*limits)
    axes.add_collection(tiles)
    _finish_field(axes, tracks, row, theme)
    _add_scale(axes, tiles, label, theme)


def _finish_field(
    axes: Axes,
    tracks: Tracks,
    row: int,
    theme: Theme,
    tips_px: NDArray[np.floating] | None = None,
) -> None:
    """Set the view, wide enough for the tips of arrows, the ticks, and the title; y is down."""
    from matplotlib.ticker import MaxNLocator

    low, high = view_px(tracks.reference_px)
    unit, px_per_unit = ("px", 1.0) if tracks.px_per_mm is None else ("mm", tracks.px_per_mm)
    for axis, first, last in zip((axes.xaxis, axes.yaxis), low, high, strict=True):
        ticks = MaxNLocator(MOST_TICKS).tick_values(first / px_per_unit, last / px_per_unit)
        axis.set_ticks(np.asarray(ticks) * px_per_unit, [f"{tick:g}" for tick in ticks])
    if tips_px is not None:
        low = np.minimum(low, tips_px.min(axis=0) - TIP_PX)
        high = np.maximum(high, tips_px.max(axis=0) + TIP_PX)
    axes.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})", aspect="equal")
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
    t_s = (tracks.t_us[row] - tracks.t_us[0]) / US_PER_S
    axes.set_title(f"t = {t_s:.3f} s", color=theme.text, fontsize=FONT_PT)


def _add_scale(axes: Axes, drawn: object, label: str, theme: Theme) -> None:
    figure = axes.get_figure()
    assert figure is not None
    # As high as the picture, whatever its aspect.
    bar = figure.colorbar(drawn, cax=axes.inset_axes((1.04, 0.0, 0.05, 1.0)))  # type: ignore[arg-type]
    bar.set_label(label, color=theme.text, fontsize=FONT_PT)
    bar.ax.tick_params(colors=theme.text, labelsize=FONT_PT - 1)
    bar.outline.set_visible(False)  # type: ignore[operator]


def plot_comparison(
    comparison: Comparison, *, theme: str = "light", width: str = "single"
) -> Figure:
    """Draw the median and the 95th percentile over the markers in time, and both by marker.

    What is no error, since nobody knows the truth, is called a difference.

    Args:
        comparison: What is drawn.
        theme: ``light`` or ``dark``.
        width: ``single`` or ``double`` column.

    Raises:
        ConfigError: A name is unknown.
    """
    figure, colors = new_figure(theme, width, COMPARISON_HEIGHT)
    over_time, by_marker = figure.subplots(2, 1)
    t_s = (comparison.t_us - comparison.t_us[0]) / US_PER_S
    lines = ((50, "median", colors.strong), (95, "95th percentile", colors.second))
    for percentile, label, color in lines:
        along, of_each = (np.percentile(comparison.distance_px, percentile, axis=n) for n in (1, 0))
        over_time.plot(t_s, along, color=color, linewidth=0.8, label=label)
        by_marker.plot(of_each, ".", color=color, markersize=3)
    over_time.set(xlabel="time (s)", xlim=(t_s[0], max(t_s[-1], 1e-6)))
    by_marker.set(xlabel="marker")
    for axes in (over_time, by_marker):
        axes.set(ylabel=f"{comparison.word} (px)", ylim=(0, None))
        style_axes(axes, colors)
    legend_above(over_time, colors)
    return figure
