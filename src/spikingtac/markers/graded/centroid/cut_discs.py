"""Where the centre of a disc is that the border of the picture cuts.

The centroid of what is seen of such a disc lies inside of the picture, however far the disc has
left it: 5 px beside the centre where half of a disc of 6 px is gone. But each distance of the
centre from the border belongs to one distance of the centroid, and to one share of the disc that is
seen. Both are computed from the disc's profile, and read the other way round. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile

CENTER_STEP_PX = 0.25
"""Steps in which the centre goes from the border inwards when the table is made, px."""

SEEN_STEP_PX = 0.125
"""Steps of the centroid's distance in the table, px; the kernel interpolates between them."""

LEAST_SEEN = 0.05
"""Least share of a disc from which its centre is told. The centroid of less is noise."""


@dataclass(frozen=True, slots=True)
class CutDiscs:
    """Centres and shares by the distance of the centroid from the border.

    Attributes:
        center_px: ``(m, n)`` distance of the centre from the outermost pixels, px, negative outside
            of them. Column k belongs to a centroid at a distance of ``k`` times SEEN_STEP_PX.
        whole: ``(m, n)`` how many times as much of the disc would be seen if nothing was cut.
    """

    center_px: NDArray[np.float64]
    whole: NDArray[np.float64]


def cut_discs(
    radius_px: NDArray[np.float64], profiles: list[DiscProfile], window_px: float, floor: float
) -> CutDiscs:
    """Tabulate how the border cuts the discs.

    Args:
        radius_px: ``(m,)`` radii of the discs, px.
        profiles: Their profiles.
        window_px: Radius of the round window in which centroids are taken, px.
        floor: Level up to which pixels count as ground.
    """
    farthest_px = float(np.ceil(window_px)) + 1.0
    at_px = np.arange(-farthest_px, farthest_px, CENTER_STEP_PX)
    seen_px = np.arange(0.0, farthest_px, SEEN_STEP_PX)
    center_px, whole = np.empty((2, len(profiles), len(seen_px)))
    for m, (radius, profile) in enumerate(zip(radius_px, profiles, strict=True)):
        mass, centroid_px = _seen_parts(at_px, float(radius), profile, window_px, floor)
        told = mass >= LEAST_SEEN * mass[-1]
        # Pixels are discrete: where the disc is whole its centroid ripples by some hundredths.
        rising_px = np.maximum.accumulate(centroid_px[told])
        center_px[m] = np.interp(seen_px, rising_px, at_px[told])
        whole[m] = np.interp(seen_px, rising_px, mass[-1] / mass[told])
    return CutDiscs(center_px, whole)


def _seen_parts(
    at_px: NDArray[np.float64],
    radius_px: float,
    profile: DiscProfile,
    window_px: float,
    floor: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Mass of what is seen of a disc, and its centroid's distance from the border, for each centre.
    half_px = np.ceil(window_px)
    along_px = np.arange(-half_px, half_px + CENTER_STEP_PX, CENTER_STEP_PX)
    column = np.arange(-half_px, half_px + 1.0)
    away_px = np.hypot(column, along_px[:, np.newaxis])
    level = (profile.level(away_px - radius_px) - floor).clip(0.0)
    row_mass = np.where(away_px <= window_px, level, 0.0).sum(axis=1)
    row = np.arange(2.0 * half_px + 2.0)
    mass = np.interp(row - at_px[:, np.newaxis], along_px, row_mass, left=0.0, right=0.0)
    total = mass.sum(axis=1)
    return total, mass @ row / np.maximum(total, 1e-9)


@njit(cache=True, nogil=True)
def uncut_kernel(
    place_px: float,
    last_px: float,
    center_px: NDArray[np.float64],
    whole: NDArray[np.float64],
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return a disc's centre along one axis, and how much more a whole disc would show.

    Args:
        place_px: Where the centroid is, px.
        last_px: The last pixel of the picture along this axis; the first is 0.
        center_px: ``(n,)`` the disc's row of :class:`CutDiscs`.
        whole: The same of the shares.
    """
    from_last = place_px > 0.5 * last_px
    seen_px = max(last_px - place_px if from_last else place_px, 0.0) / SEEN_STEP_PX
    entry = int(seen_px)
    if entry >= center_px.size - 1:
        return place_px, 1.0
    part = seen_px - entry
    inward_px = (1.0 - part) * center_px[entry] + part * center_px[entry + 1]
    more = (1.0 - part) * whole[entry] + part * whole[entry + 1]
    return (last_px - inward_px if from_last else inward_px), more
