"""Figures of tracks: displacement over time, vector field, heat map, strain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing
from spikingtac.errors import ConfigError, named, require_type
from spikingtac.plots.field_view import draw_values, keep_in_view, pitch_px, view_px
from spikingtac.plots.summary import PICTURE_ENDINGS
from spikingtac.plots.theme import (
    DPI,
    FONT_PT,
    Theme,
    fit_height,
    legend_above,
    new_figure,
    style_axes,
)
from spikingtac.touch.field import GradientOperator
from spikingtac.tracks import Tracks
from spikingtac.tracks.comparison import LOADED, Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.quiver import Quiver

Kind = Literal["course", "field", "map", "strain"]
US_PER_S = 1_000_000
MOST_TICKS = 6  # Most intervals between the ticks of an axis of a field.
ARROW_SHARE = 0.9  # Length of the longest arrow over the distance of neighbouring markers.

# Height of a time course, the largest of a field with its scale, and that of a comparison, over
# the width.
COURSE_HEIGHT, FIELD_HEIGHT, COMPARISON_HEIGHT = 0.62, 1.3, 1.05


@dataclass(frozen=True)
class FieldArrows:
    """Arrows of a field, whose scale stays while they turn.

    Attributes:
        quiver: What is drawn.
        gain: Length of an arrow over that of its displacement.
        px_per_unit: Scale of their colours: px of displacement per unit shown.
    """

    quiver: Quiver
    gain: float
    px_per_unit: float

    @property
    def told(self) -> str:
        """How much longer than the displacements they are, in words."""
        return f"arrows × {self.gain:.2g}"

    def point_to(self, displacement_px: NDArray[np.floating]) -> None:
        """Show ``(m, 2)`` displacements, px."""
        x, y = displacement_px.T
        self.quiver.set_UVC(x * self.gain, y * self.gain, np.hypot(x, y) / self.px_per_unit)


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
    draw = named(_KINDS, kind, "kind of plot")
    require_estimates(tracks)
    height = COURSE_HEIGHT if kind == "course" else FIELD_HEIGHT
    figure, colors = new_figure(theme, width, height)
    axes = figure.add_subplot()
    style_axes(axes, colors)
    draw(axes, tracks, _row(tracks, at_us), colors)
    if kind != "course":
        fit_height(figure)
    return figure


def require_estimates(tracks: Tracks) -> None:
    """Raise ConfigError where there is nothing to draw."""
    if not len(tracks.t_us):
        raise ConfigError("these tracks hold no estimate; there is nothing to draw")


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, SVG or PDF; it appears whole or not at all.

    Raises:
        ConfigError: The ending is none of these, or the folder does not exist.
    """
    target = Path(path)
    if target.suffix not in PICTURE_ENDINGS:
        valid = ", ".join(PICTURE_ENDINGS)
        raise ConfigError(f"cannot draw {target.name!r} (valid endings: {valid})")
    if not target.parent.is_dir():
        raise ConfigError(f"the folder {str(target.parent)!r} does not exist; create it first")
    with replacing(target) as partial:
        figure.savefig(partial, facecolor=figure.get_facecolor(), dpi=DPI)


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


def draw_course(axes: Axes, tracks: Tracks, row: int, theme: Theme) -> None:
    """Draw the length of every marker's displacement over time; ``row`` is not asked."""
    draw_course_thinned(axes, tracks, len(tracks.t_us), theme)
    legend_above(axes, theme)


def draw_course_thinned(axes: Axes, tracks: Tracks, most_points: int, theme: Theme) -> None:
    """Draw the same without a legend and with so many estimates at most.

    For animations: all of it is drawn again for every picture.
    """
    moved, unit = _moved(tracks)
    some = slice(None, None, max(len(tracks.t_us) // most_points, 1))
    length = np.hypot(moved[some, :, 0], moved[some, :, 1])
    t_s = (tracks.t_us[some] - tracks.t_us[0]) / US_PER_S
    labels = ["each marker", *["_"] * (length.shape[1] - 1)]  # "_" names nothing
    axes.plot(t_s, length, color=theme.soft, linewidth=0.3, alpha=0.6, label=labels)
    axes.plot(t_s, np.median(length, axis=1), color=theme.second, linewidth=1.0, label="median")
    axes.plot(t_s, length.max(axis=1), color=theme.strong, linewidth=1.0, label="largest")
    axes.set(xlabel="time (s)", ylabel=f"displacement ({unit})", xlim=(t_s[0], max(t_s[-1], 1e-6)))


def draw_field(axes: Axes, tracks: Tracks, row: int, theme: Theme) -> FieldArrows:
    """Draw the displacements of an estimate as arrows; return them, for an animation.

    Args:
        axes: Where to draw.
        tracks: Whose estimate.
        row: Which one; its longest arrow sets the scale.
        theme: Colours.
    """
    _, unit = _moved(tracks)
    rest = tracks.reference_px
    longest_px = max(float(np.hypot(*tracks.displacement_px[row].T).max()), 1e-9)
    none = np.zeros(len(rest))
    quiver = axes.quiver(
        *rest.T, none, none, none,
        cmap=theme.magnitudes(), angles="xy", scale_units="xy", scale=1, width=0.006,
    )  # fmt: skip
    arrows = FieldArrows(
        quiver=quiver,
        gain=ARROW_SHARE * pitch_px(rest) / longest_px,
        px_per_unit=tracks.px_per_mm or 1.0,
    )
    arrows.point_to(tracks.displacement_px[row])
    quiver.set_clim(0.0, longest_px / arrows.px_per_unit)
    axes.plot(*rest.T, ".", color=theme.soft, markersize=1.5, zorder=0)
    _finish_field(axes, tracks, row, theme)
    keep_in_view(axes, rest + arrows.gain * tracks.displacement_px[row])
    axes.set_title(f"{axes.get_title()}, {arrows.told}", color=theme.text, fontsize=FONT_PT)
    _add_scale(axes, quiver, f"displacement ({unit})", theme)
    return arrows


def _draw_map(axes: Axes, tracks: Tracks, row: int, theme: Theme) -> None:
    moved, unit = _moved(tracks)
    draw_values(axes, tracks, np.hypot(*moved[row].T), theme.magnitudes(), (0.0, None))
    _finish_field(axes, tracks, row, theme)
    _add_scale(axes, axes.collections[0], f"displacement ({unit})", theme)


def _draw_strain(axes: Axes, tracks: Tracks, row: int, theme: Theme) -> None:
    operator = GradientOperator(tracks.reference_px.astype(np.float64))
    growth = 100.0 * operator.of(tracks.displacement_px[row].astype(np.float64)).divergence
    bound = max(float(np.abs(growth).max()), 1e-9)
    draw_values(axes, tracks, growth, theme.diverging, (-bound, bound))
    _finish_field(axes, tracks, row, theme)
    _add_scale(axes, axes.collections[0], "growth of area (%)", theme)


_KINDS: dict[str, Callable[[Axes, Tracks, int, Theme], object]] = {
    "course": draw_course,
    "field": draw_field,
    "map": _draw_map,
    "strain": _draw_strain,
}


def _finish_field(axes: Axes, tracks: Tracks, row: int, theme: Theme) -> None:
    from matplotlib.ticker import MaxNLocator

    (left, top), (right, bottom) = view_px(tracks.reference_px)
    unit, px_per_unit = ("px", 1.0) if tracks.px_per_mm is None else ("mm", tracks.px_per_mm)
    for axis, low, high in ((axes.xaxis, left, right), (axes.yaxis, top, bottom)):
        ticks = MaxNLocator(MOST_TICKS).tick_values(low / px_per_unit, high / px_per_unit)
        axis.set_ticks(np.asarray(ticks) * px_per_unit, [f"{tick:g}" for tick in ticks])
    axes.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})", aspect="equal")
    axes.set(xlim=(left, right), ylim=(bottom, top))
    t_s = (tracks.t_us[row] - tracks.t_us[0]) / US_PER_S
    axes.set_title(f"t = {t_s:.3f} s", color=theme.text, fontsize=FONT_PT)


def _add_scale(axes: Axes, drawn: object, label: str, theme: Theme) -> None:
    figure = axes.get_figure()
    assert figure is not None
    beside = axes.inset_axes((1.04, 0.0, 0.05, 1.0))  # as high as the picture, whatever its aspect
    bar = figure.colorbar(drawn, cax=beside)  # type: ignore[arg-type]
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
    for percentile, color in ((50, colors.strong), (95, colors.second)):
        along = np.percentile(comparison.distance_px, percentile, axis=1)
        label = "median" if percentile == 50 else "95th percentile"
        over_time.plot(t_s, along, color=color, linewidth=0.8, label=label)
        values = np.percentile(comparison.distance_px, percentile, axis=0)
        by_marker.plot(values, ".", color=color, markersize=3)
    style_axes(over_time, colors)
    style_axes(by_marker, colors)
    named = f"{comparison.word} (px)"
    over_time.set(
        xlabel="time (s)", ylabel=named, ylim=(0, None), xlim=(t_s[0], max(t_s[-1], 1e-6))
    )
    by_marker.set(xlabel="marker", ylabel=named, ylim=(0, None))
    legend_above(over_time, colors)
    return figure
