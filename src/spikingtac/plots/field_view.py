"""Where the markers of a field stand in a figure: the view, the pitch, the cells between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spikingtac.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap

# Free space around the markers of a field, px: about half a pitch of the usual grids.
MARGIN_PX = 20.0
TIP_PX = 2.0  # Free space around the tip of an arrow, px.


def view_px(rest_px: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the upper left and the lower right corner of the view of markers, px."""
    margin = max(MARGIN_PX, 0.6 * pitch_px(rest_px))
    return rest_px.min(axis=0) - margin, rest_px.max(axis=0) + margin


def view_aspect(rest_px: NDArray[np.floating]) -> float:
    """Return height over width of the picture of markers that rest at ``(m, 2)`` places, px."""
    (left, top), (right, bottom) = view_px(rest_px)
    return float((bottom - top) / (right - left))


def keep_in_view(axes: Axes, places_px: NDArray[np.floating]) -> None:
    """Widen the view to what is drawn at ``(m, 2)`` places, px; y is down."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    low, high = places_px.min(axis=0) - TIP_PX, places_px.max(axis=0) + TIP_PX
    axes.set_xlim(min(left, low[0]), max(right, high[0]))
    axes.set_ylim(max(bottom, high[1]), min(top, low[1]))


def pitch_px(rest: NDArray[np.floating]) -> float:
    """Return the median distance of the nearest neighbour, px."""
    if len(rest) < 2:
        return MARGIN_PX
    apart = np.hypot(*np.moveaxis(rest[:, np.newaxis] - rest, 2, 0))
    np.fill_diagonal(apart, np.inf)
    return float(np.median(apart.min(axis=1)))


def draw_values(
    axes: Axes,
    tracks: Tracks,
    values: NDArray[np.floating],
    colors: str | Colormap,
    bounds: tuple[float, float | None],
) -> None:
    """Draw a value at each marker: as the cell between its neighbours, or as a square."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    grid = tracks.meta.get("grid") or (0, 0)
    if min(grid) > 1 and grid[0] * grid[1] == len(values):
        corners = cell_corners(tracks.reference_px.reshape(*grid, 2))
        limits = dict(zip(("vmin", "vmax"), bounds, strict=True))
        axes.pcolormesh(*np.moveaxis(corners, 2, 0), values.reshape(grid), cmap=colors, **limits)
        return
    pitch = pitch_px(tracks.reference_px)
    squares = [
        Rectangle((float(x) - pitch / 2, float(y) - pitch / 2), pitch, pitch)
        for x, y in tracks.reference_px
    ]
    tiles = PatchCollection(squares, cmap=colors, linewidth=0)
    tiles.set_array(values)
    tiles.set_clim(*bounds)
    axes.add_collection(tiles)


def cell_corners(rest_px: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return ``(rows + 1, columns + 1, 2)`` corners of the cells around ``(rows, columns, 2)``.

    A corner is the mean of the four markers around it; beyond the border the grid goes on evenly.
    """
    wide = rest_px
    for axis in (0, 1):
        first, second = (np.take(wide, [at], axis) for at in (0, 1))
        last, before = (np.take(wide, [at], axis) for at in (-1, -2))
        wide = np.concatenate([2 * first - second, wide, 2 * last - before], axis)
    return (wide[:-1, :-1] + wide[1:, :-1] + wide[:-1, 1:] + wide[1:, 1:]) / 4
