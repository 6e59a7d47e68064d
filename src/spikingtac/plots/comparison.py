"""A figure of a comparison: errors over time and by marker."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spikingtac.plots.theme import legend_above, new_figure, style_axes
from spikingtac.tracks.comparison import Comparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEIGHT_SHARE = 1.05
US_PER_S = 1_000_000


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
    figure, colors = new_figure(theme, width, HEIGHT_SHARE)
    over_time, by_marker = figure.subplots(2, 1)
    t_s = (comparison.t_us - comparison.t_us[0]) / US_PER_S
    for percentile, color in ((50, colors.strong), (95, colors.second)):
        along = np.percentile(comparison.error_px, percentile, axis=1)
        label = "median" if percentile == 50 else "95th percentile"
        over_time.plot(t_s, along, color=color, linewidth=0.8, label=label)
        values = np.percentile(comparison.error_px, percentile, axis=0)
        by_marker.plot(values, ".", color=color, markersize=3)
    style_axes(over_time, colors)
    style_axes(by_marker, colors)
    named = f"{'error' if comparison.truth else 'difference'} (px)"
    over_time.set(
        xlabel="time (s)", ylabel=named, ylim=(0, None), xlim=(t_s[0], max(t_s[-1], 1e-6))
    )
    by_marker.set(xlabel="marker", ylabel=named, ylim=(0, None))
    legend_above(over_time, colors)
    return figure
