"""The direction of a pixel's last event fades as its marker moves on.

Just after an event the level of a pixel most likely goes on in the same direction, so that the map
expects it half a step farther. An edge that moves on brings the next event soon. Where none comes,
the motion turned round, or the pixel passed a plateau: its level may then lie anywhere in the band
from one OFF step below its last event to one ON step above. Where OFF events are rare that matters:
a pixel that rose on the way out falls on the way back by up to two fifths of a swing without an
event. So the expected level goes to the middle of its band, the sooner the more the motion should
have changed it. Which way that change went is left open on purpose: a map that follows its own fit
runs away with it (measured: markers are lost). Ours.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.graded.profile_tables import ProfileTables
from spikingtac.state_map.graded import PAD_PX, GradedStateMap

LEAST_WAY_PX = 0.1
"""A marker is looked at after it went this far: less work, same effect (ours)."""

REACH_SHARE = 0.6
"""Share of a table's reach within which an edge is steep enough to matter: 4 edge scales."""


class DirectionFading:
    """Fades the directions around one sensor's markers."""

    def __init__(
        self, reference_px: NDArray[np.float64], tables: ProfileTables, bands: float
    ) -> None:
        """Begin with markers at rest.

        Args:
            reference_px: ``(m, 2)`` rest positions, px.
            tables: Profiles of the discs.
            bands: Change of the level, in widths of its band, after which half of the direction is
                forgotten.
        """
        self._seen_px = reference_px.astype(np.float64)
        self._tables = tables
        self._bands = bands

    def update(
        self,
        state_map: GradedStateMap,
        position_px: NDArray[np.float64],
        outline_px: NDArray[np.float64],
    ) -> None:
        """Let the map forget directions around the markers that moved.

        Args:
            state_map: The map; its expected levels change.
            position_px: ``(m, 2)`` where the markers are, px.
            outline_px: ``(m, 3)`` their outlines (:mod:`spikingtac.markers.graded.disc_fit`), px.
        """
        fade_directions_kernel(
            state_map.padded,
            state_map.memory,
            state_map.signed_steps,
            (position_px, outline_px, self._seen_px),
            (self._tables.values, self._tables.reach_px),
            (self._bands, LEAST_WAY_PX),
        )


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _fade_row_kernel(
    row: tuple[Any, ...], first_px: Any, dy: Any, shape: tuple[Any, ...], way: tuple[Any, Any, Any]
) -> None:  # pragma: no cover - compiled
    """Fade a row of pixels; ``row`` is levels, sums, signed steps and the table of slopes.

    ``way`` is how far the disc moved, x and y, px, and the bands that forget half.
    """
    levels, sums, steps, slope = row
    b, c, start, scale, last = shape
    way_x, way_y, bands = way
    zero, half, one = np.float32(0.0), np.float32(0.5), np.float32(1.0)
    for k in range(levels.size):
        dx = first_px + np.float32(np.int32(k))
        rho = np.sqrt(dx * dx + dy * dy + np.float32(1e-6))
        ux, uy = dx / rho, dy / rho
        bulge = b * (ux * ux - uy * uy) + np.float32(2.0) * c * ux * uy
        place = (rho - start - bulge) * scale
        place = place if place > zero else zero
        fall = slope[np.int32(place if place < last else last)]
        change = abs(fall * (ux * way_x + uy * way_y))
        band = steps[k, 1] - steps[k, 0]
        middle = sums[k] + half * (steps[k, 0] + steps[k, 1])
        level = middle + (levels[k] - middle) / (one + change / (bands * band))
        level = level if level > zero else zero
        levels[k] = level if level < one else one


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def fade_directions_kernel(
    padded: NDArray[np.float32],
    memory: NDArray[np.float32],
    signed_steps: NDArray[np.float32],
    discs: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    tables: tuple[NDArray[np.float32], NDArray[np.float64]],
    limits: tuple[float, float],
) -> None:  # pragma: no cover - compiled
    """Move expected levels towards the middles of their bands, in place.

    Args:
        padded: Expected levels with their margin of PAD_PX; changed.
        memory: ``(height, width)`` levels at each pixel's last event.
        signed_steps: ``(height, width, 2)`` steps, falling (negative) and rising.
        discs: ``(m, 2)`` centres, px; ``(m, 3)`` outlines, px; ``(m, 2)`` where each disc was when
            it was last looked at, px, which is kept up to date.
        tables: Values and reaches of :class:`ProfileTables`.
        limits: Change of a level, in bands, that forgets half; shortest way, px.
    """
    center_px, outline_px, seen_px = discs
    values, reach_px = tables
    height, width = memory.shape
    last = np.float32(values.shape[2] - 1)
    for m in range(center_px.shape[0]):
        x, y = center_px[m, 0], center_px[m, 1]
        way_x, way_y = x - seen_px[m, 0], y - seen_px[m, 1]
        if np.hypot(way_x, way_y) < limits[1]:
            continue
        seen_px[m, 0], seen_px[m, 1] = x, y
        way = np.float32(way_x), np.float32(way_y), np.float32(limits[0])
        outer = outline_px[m, 0] + REACH_SHARE * reach_px[m]
        start = np.float32(outline_px[m, 0] - reach_px[m])
        scale = np.float32(0.5 * last / reach_px[m])
        shape = np.float32(outline_px[m, 1]), np.float32(outline_px[m, 2]), start, scale, last
        for row in range(max(0, int(np.ceil(y - outer))), min(height - 1, int(y + outer)) + 1):
            half = np.sqrt(max(outer * outer - (row - y) ** 2, 0.0))
            first = max(0, int(np.ceil(x - half)))
            after = max(min(width - 1, int(x + half)) + 1, first)
            of_row = (
                padded[row + PAD_PX, PAD_PX + first : PAD_PX + after],
                memory[row, first:after],
                signed_steps[row, first:after],
                values[m, 2],
            )
            _fade_row_kernel(of_row, np.float32(first - x), np.float32(row - y), shape, way)
