"""The rims of the markers as cells: how far from the edge a pixel lies, and in which direction.

A marker that moves by a small step changes the pixels ahead of its edge one way and those behind it
the other way. Pixels that are equally far from an edge, in the same direction, see the same light,
so the events of all markers are counted together, cell by cell.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]
Cells = NDArray[np.int16]

REACH_PX = 3.0
"""Distance from the edge up to which pixels are looked at, px (ours: an edge's width and twice the
largest amplitude that is asked of a vibration)."""
RINGS = 24
"""Rings within that distance on both sides of the edge: 0.25 px each (ours: a third of an edge)."""
SECTORS = 16
"""Directions: 22.5 degrees each."""
CELLS = RINGS * SECTORS
NO_CELL = -1
RING_PX = 2.0 * REACH_PX / RINGS
FULL_TURN = 2.0 * np.pi


def ring_distances_px() -> Field:
    """Return the distance ``(RINGS,)`` of each ring's middle from the edge, px; inside negative."""
    return np.linspace(-REACH_PX, REACH_PX, RINGS, endpoint=False) + 0.5 * RING_PX


def sector_normals() -> Field:
    """Return the direction ``(SECTORS, 2)`` away from the marker in the middle of each sector."""
    angle = (np.arange(SECTORS) + 0.5) * (FULL_TURN / SECTORS) - np.pi
    return np.column_stack([np.cos(angle), np.sin(angle)])


class RimCells:
    """Which cell each pixel belongs to.

    Attributes:
        cell: ``(height, width) int16`` cell of each pixel, ring by ring; -1 where there is none.
        pixels: ``(RINGS, SECTORS)`` number of pixels in each cell.
    """

    def __init__(self, radius_px: Field, size: tuple[int, int]) -> None:
        """Prepare for markers of known radii.

        Args:
            radius_px: ``(m,)`` radii, px.
            size: ``(width, height)`` of the sensor, px.
        """
        self._radius = np.asarray(radius_px, np.float64)
        width, height = size
        self.cell: Cells = np.full((height, width), NO_CELL, np.int16)
        self._distance = np.empty((height, width), np.float32)
        self.pixels = np.zeros((RINGS, SECTORS), np.int64)

    def place(self, center_px: Field) -> None:
        """Put the markers to places ``(m, 2)``, px."""
        place_rims_kernel(
            np.asarray(center_px, np.float64), self._radius, self.cell, self._distance
        )
        inside = self.cell[self.cell != NO_CELL]
        self.pixels[:] = np.bincount(inside, minlength=CELLS).reshape(RINGS, SECTORS)


@njit(cache=True, nogil=True)
def place_rims_kernel(
    center: Field, radius: Field, cell: Cells, distance: NDArray[np.float32]
) -> None:
    """Fill ``cell``; a pixel near two edges belongs to the nearer one.

    Args:
        center: ``(m, 2)`` places, px.
        radius: ``(m,)`` radii, px.
        cell: ``(height, width)`` overwritten.
        distance: ``(height, width)`` room for the distances to the nearest edge.
    """
    height, width = cell.shape
    for y in range(height):
        for x in range(width):
            cell[y, x] = NO_CELL
            distance[y, x] = REACH_PX
    for marker in range(len(center)):
        reach = radius[marker] + REACH_PX
        left, right = center[marker, 0] - reach, center[marker, 0] + reach
        top, bottom = center[marker, 1] - reach, center[marker, 1] + reach
        for y in range(max(0, int(top)), min(height, int(bottom) + 2)):
            for x in range(max(0, int(left)), min(width, int(right) + 2)):
                dx, dy = x - center[marker, 0], y - center[marker, 1]
                away = np.hypot(dx, dy) - radius[marker]
                if not abs(away) < distance[y, x]:
                    continue
                distance[y, x] = abs(away)
                ring = min(int((away + REACH_PX) / RING_PX), RINGS - 1)
                turn = (np.arctan2(dy, dx) + np.pi) / FULL_TURN
                cell[y, x] = ring * SECTORS + min(int(turn * SECTORS), SECTORS - 1)
