"""The area of every disc on a graded map, and what keeps that map clean around the discs.

A level is the share of the full swing between ground and disc, so its sum over a disc's
surroundings is the disc's area in px squared, wherever its centre lies. Far inside of a disc a
level is 1, between the discs it is 0: what leak and noise have left there is wiped off, since a rim
that comes by would take it along. Where discs lie densely, the ground about one disc is the rim of
its neighbour, so a pixel belongs to one disc only: the one to whose ring it has the shortest
tangent (the power diagram of the rings, F. Aurenhammer, SIAM J. Comput. 16, 1987; halfway between
equals).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]
Levels = NDArray[np.float32]
Neighbours = NDArray[np.int64]

INSIDE_PX = 2.0
"""Pixels farther than this inside of a rim are in the disc, px (ours: with 4 the growth errs by
0.006 instead of 0.005 on a training scene, by 0.038 instead of 0.008 where the sensor is noisy)."""
OUTSIDE_PX = 2.0
"""Pixels farther than this outside of a rim are ground, px (ours: as above; with 1.5 strained discs
leave the ring)."""
PROFILE_STEP_PX = 0.25
"""Distance between two entries of a profile, px."""
NEIGHBOURS = 8
"""Discs nearest at rest that may own a disc's surroundings: all those around it in a grid."""


def disc_neighbours(center_px: Field) -> Neighbours:
    """Return the nearest discs ``(m, k)`` of each of ``(m, 2)``; k is 8, or less of few."""
    square = ((center_px[:, None] - center_px[None]) ** 2).sum(axis=2)
    np.fill_diagonal(square, np.inf)
    few = min(NEIGHBOURS, len(center_px) - 1)
    return np.ascontiguousarray(np.argsort(square, axis=1, kind="stable")[:, :few])


@njit(cache=True, nogil=True)
def borders_kernel(
    marker: int, center_px: Field, bounds_px: Field, near: Neighbours, borders: Field
) -> int:
    """Find the borders between a disc and its neighbours that lie within its reach.

    Args:
        marker: The disc.
        center_px: ``(m, 2)`` where the discs are, px.
        bounds_px: ``(m, 3)`` the second is the radius of the ring, the third the reach, px.
        near: ``(m, k)`` neighbours of each disc.
        borders: ``(k, 3)`` overwritten: a pixel at (x, y) from the centre is the disc's own where
            the first times x and the second times y are no more than the third.

    Returns:
        How many borders there are.
    """
    found, ring, reach = 0, bounds_px[marker, 1], bounds_px[marker, 2]
    for k in range(near.shape[1]):
        other = near[marker, k]
        x = center_px[other, 0] - center_px[marker, 0]
        y = center_px[other, 1] - center_px[marker, 1]
        square = x * x + y * y
        middle = 0.5 * (square + ring * ring - bounds_px[other, 1] ** 2)
        if middle < reach * np.sqrt(square):
            borders[found, 0], borders[found, 1], borders[found, 2] = x, y, middle
            found += 1
    return found


@njit(cache=True, nogil=True)
def own_columns_kernel(y: float, reach: float, borders: Field, found: int) -> tuple[float, float]:
    """Return the first and the last place of a row that a disc owns, from its centre, px.

    Args:
        y: The row, from the centre, px.
        reach: Distance within which pixels are looked at, px.
        borders: ``(k, 3)`` of :func:`borders_kernel`.
        found: How many of them there are.
    """
    low, high = -reach, reach
    for k in range(found):
        left = borders[k, 2] - borders[k, 1] * y
        if borders[k, 0] > 0.0:
            high = min(high, left / borders[k, 0])
        elif borders[k, 0] < 0.0:
            low = max(low, left / borders[k, 0])
        elif left < 0.0:
            return 1.0, 0.0
    return low, high


@njit(cache=True, nogil=True)
def disc_areas_kernel(
    maps: tuple[Levels, Levels],
    center_px: Field,
    bounds_px: Field,
    near: Neighbours,
    area_px2: Field,
) -> None:
    """Wipe the map around the discs, and sum it over each.

    Args:
        maps: ``(height, width)`` clipped sums of the events, and expected levels; wiped inside and
            between discs.
        center_px: ``(m, 2)`` where the discs are, px.
        bounds_px: ``(m, 3)`` distances within which a pixel is disc, within which it is counted,
            and within which it is wiped, px.
        near: ``(m, k)`` neighbours of each disc.
        area_px2: ``(m,)`` overwritten.
    """
    memory, level = maps
    height, width = level.shape
    borders = np.empty((near.shape[1], 3))
    for marker in range(len(center_px)):
        found = borders_kernel(marker, center_px, bounds_px, near, borders)
        x, y = center_px[marker, 0], center_px[marker, 1]
        core, rim, reach = bounds_px[marker, 0], bounds_px[marker, 1], bounds_px[marker, 2]
        total = 0.0
        for row in range(max(int(np.ceil(y - reach)), 0), min(int(y + reach) + 1, height)):
            low, high = own_columns_kernel(row - y, reach, borders, found)
            for column in range(max(int(np.ceil(x + low)), 0), min(int(x + high) + 1, width)):
                square = (column - x) ** 2 + (row - y) ** 2
                if square > reach * reach:
                    continue
                if square > rim * rim:
                    memory[row, column] = level[row, column] = np.float32(0.0)
                    continue
                if square < core * core:
                    memory[row, column] = level[row, column] = np.float32(1.0)
                total += level[row, column]
        area_px2[marker] = total


@njit(cache=True, nogil=True)
def return_outlines_kernel(
    maps: tuple[Levels, Levels],
    center_px: Field,
    bounds_px: Field,
    near: Neighbours,
    profiles: Field,
    share: float,
) -> None:
    """Draw the levels around resting discs towards what was calibrated.

    Args:
        maps: ``(height, width)`` clipped sums and expected levels.
        center_px: ``(m, 2)`` where the discs are, px.
        bounds_px: ``(m, 3)`` the second is the distance within which pixels are drawn, px.
        near: ``(m, k)`` neighbours of each disc.
        profiles: ``(m, k)`` levels at distances of 0, 0.25, 0.5 ... px from a disc's centre.
        share: How far, 0 to 1.
    """
    memory, level = maps
    height, width = level.shape
    borders = np.empty((near.shape[1], 3))
    for marker in range(len(center_px)):
        found = borders_kernel(marker, center_px, bounds_px, near, borders)
        x, y, rim = center_px[marker, 0], center_px[marker, 1], bounds_px[marker, 1]
        for row in range(max(int(np.ceil(y - rim)), 0), min(int(y + rim) + 1, height)):
            low, high = own_columns_kernel(row - y, rim, borders, found)
            for column in range(max(int(np.ceil(x + low)), 0), min(int(x + high) + 1, width)):
                away = np.sqrt((column - x) ** 2 + (row - y) ** 2)
                if away > rim:
                    continue
                place = min(away / PROFILE_STEP_PX, profiles.shape[1] - 1.001)
                below = int(place)
                part = place - below
                wanted = (1.0 - part) * profiles[marker, below] + part * profiles[marker, below + 1]
                memory[row, column] += np.float32(share * (wanted - memory[row, column]))
                level[row, column] += np.float32(share * (wanted - level[row, column]))
