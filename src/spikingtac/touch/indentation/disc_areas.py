"""The area of every disc on a graded map, and what keeps that map clean around the discs.

A level is the share of the full swing between ground and disc, so its sum over a disc's
surroundings is the disc's area in px squared, wherever its centre lies. Far inside of a disc a
level is 1, between the discs it is 0: what leak and noise have left there is wiped off, since a rim
that comes by would take it along. What is within another disc's rim is left alone.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]
Levels = NDArray[np.float32]

INSIDE_PX = 2.0
"""Pixels farther than this inside of a rim are in the disc, px (ours: with 4 the growth errs by
0.006 instead of 0.005 on a training scene, by 0.038 instead of 0.008 where the sensor is noisy)."""
OUTSIDE_PX = 2.0
"""Pixels farther than this outside of a rim are ground, px (ours: as above; with 1.5 strained discs
leave the ring)."""
PROFILE_STEP_PX = 0.25
"""Distance between two entries of a profile, px."""


@njit(cache=True, nogil=True)
def disc_areas_kernel(
    memory: Levels, level: Levels, center_px: Field, bounds_px: Field, area_px2: Field
) -> None:
    """Wipe the map around the discs, and sum it over each.

    Args:
        memory: ``(height, width)`` clipped sums of the events; wiped inside and between discs.
        level: ``(height, width)`` expected levels; wiped likewise.
        center_px: ``(m, 2)`` where the discs are, px.
        bounds_px: ``(m, 3)`` distances within which a pixel is disc, within which it is counted,
            and within which it is wiped, px.
        area_px2: ``(m,)`` overwritten.
    """
    height, width = level.shape
    for marker in range(len(center_px)):
        x, y = center_px[marker, 0], center_px[marker, 1]
        core, rim, reach = bounds_px[marker, 0], bounds_px[marker, 1], bounds_px[marker, 2]
        near = _near(marker, center_px, bounds_px)
        near_px, near_rim = center_px[near], bounds_px[near, 1]
        total = 0.0
        for row in range(max(int(np.ceil(y - reach)), 0), min(int(y + reach) + 1, height)):
            for column in range(max(int(np.ceil(x - reach)), 0), min(int(x + reach) + 1, width)):
                square = (column - x) ** 2 + (row - y) ** 2
                if square > reach * reach:
                    continue
                if square > rim * rim:
                    if _within(column, row, near_px, near_rim):
                        continue
                    memory[row, column] = level[row, column] = np.float32(0.0)
                    continue
                if square < core * core:
                    memory[row, column] = level[row, column] = np.float32(1.0)
                total += level[row, column]
        area_px2[marker] = total


@njit(cache=True, nogil=True)
def _near(marker: int, center_px: Field, bounds_px: Field) -> NDArray[np.int64]:
    """Return the other discs whose rims reach into what is wiped around a disc."""
    near = np.empty(len(center_px), np.int64)
    count = 0
    for other in range(len(center_px)):
        away = center_px[other] - center_px[marker]
        reach = bounds_px[marker, 2] + bounds_px[other, 1]
        if other != marker and away[0] ** 2 + away[1] ** 2 < reach**2:
            near[count] = other
            count += 1
    return near[:count]


@njit(cache=True, nogil=True)
def _within(column: int, row: int, center_px: Field, rim_px: Field) -> bool:
    """Return whether a pixel lies within the rim of any of some discs."""
    for disc in range(len(center_px)):
        square = (column - center_px[disc, 0]) ** 2 + (row - center_px[disc, 1]) ** 2
        if square <= rim_px[disc] ** 2:
            return True
    return False


@njit(cache=True, nogil=True)
def return_outlines_kernel(
    maps: tuple[Levels, Levels], center_px: Field, rim_px: Field, profiles: Field, share: float
) -> None:
    """Draw the levels around resting discs towards what was calibrated.

    Args:
        maps: ``(height, width)`` clipped sums and expected levels.
        center_px: ``(m, 2)`` where the discs are, px.
        rim_px: ``(m,)`` distance within which pixels are drawn, px.
        profiles: ``(m, k)`` levels at distances of 0, 0.25, 0.5 ... px from a disc's centre.
        share: How far, 0 to 1.
    """
    memory, level = maps
    height, width = level.shape
    for marker in range(len(center_px)):
        x, y, rim = center_px[marker, 0], center_px[marker, 1], rim_px[marker]
        for row in range(max(int(np.ceil(y - rim)), 0), min(int(y + rim) + 1, height)):
            for column in range(max(int(np.ceil(x - rim)), 0), min(int(x + rim) + 1, width)):
                away = np.sqrt((column - x) ** 2 + (row - y) ** 2)
                if away > rim:
                    continue
                place = min(away / PROFILE_STEP_PX, profiles.shape[1] - 1.001)
                below = int(place)
                part = place - below
                wanted = (1.0 - part) * profiles[marker, below] + part * profiles[marker, below + 1]
                memory[row, column] += np.float32(share * (wanted - memory[row, column]))
                level[row, column] += np.float32(share * (wanted - level[row, column]))
