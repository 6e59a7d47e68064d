"""Follow known markers along slides, forwards and backwards, at regular times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.slide_map import SlideMap
from spikingtac.markers.graded.disc_fit import fit_discs_kernel, round_outline
from spikingtac.markers.graded.fit_window import fit_window
from spikingtac.markers.profile import DiscProfile
from spikingtac.state_map.graded import OUTSIDE_LEVEL, PAD_PX

REACH_PX = 3.5
"""Half the width of the annulus that a fit reads, px: as the disc tracker's."""

ITERATIONS = 6
"""Gauss-Newton steps at most: with 2 px each, enough for 12 px between two samples."""

FEWEST_AGREEMENT = 0.4
"""Share of the edge that must agree with a fit for it to be believed."""


@dataclass(frozen=True, slots=True)
class Course:
    """Where markers went.

    Attributes:
        position_px: ``(n, m, 2)`` centres, in the order of time, px.
        agreement: ``(n, m)`` share of each marker's edge that agrees with the fit, 0 to 1.
        maps: ``(height, width)`` maps at the times that were asked for.
    """

    position_px: NDArray[np.float64]
    agreement: NDArray[np.float64]
    maps: list[NDArray[np.float32]]


def follow(
    slide_map: SlideMap,
    index: NDArray[np.int64],
    start_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    profile: DiscProfile,
    keep: NDArray[np.int64],
) -> Course:
    """Fit the markers at each time, beginning at the map's own end of the recording.

    Args:
        slide_map: The map; it is moved along.
        index: ``(n,)`` how many events came before each time, in the order of time.
        start_px: ``(m, 2)`` where the markers are at the first time visited, px.
        radius_px: ``(m,)`` radii, px.
        profile: The discs' profile.
        keep: Which of the ``n`` times to keep a map of.
    """
    window = fit_window([profile] * len(radius_px), slide_map.values.shape[1], REACH_PX)
    pixels, curves = window.pixels, window.curves(ITERATIONS)
    outline_px = round_outline(radius_px)
    center = np.array(start_px, np.float64)
    speed = np.zeros_like(center)
    agreement = np.zeros(len(center))
    position = np.empty((len(index), *center.shape))
    agreed = np.empty((len(index), len(center)))
    maps: dict[int, NDArray[np.float32]] = {}
    kept = set(keep.tolist())
    for i in slide_map.order(len(index)):
        slide_map.move_to(int(index[i]))
        before = center.copy()
        center += speed
        fit_discs_kernel(
            slide_map.padded,
            center,
            outline_px,
            pixels,
            curves,
            (center, 0.0),
            (radius_px, 0.0, 0.0),
            agreement,
        )
        # A marker whose edge is not there must not run away on its last speed.
        seen = agreement > FEWEST_AGREEMENT
        speed = np.where(seen[:, np.newaxis], center - before, 0.0)
        center[~seen] = before[~seen]
        position[i], agreed[i] = center, agreement
        if i in kept:
            maps[i] = slide_map.values
    return Course(position, agreed, [maps[i] for i in sorted(maps)])


def refit(
    maps: list[NDArray[np.float32]],
    position_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    profile: DiscProfile,
) -> NDArray[np.float64]:
    """Return ``(len(maps), m, 2)`` positions fitted anew to single maps, px.

    Args:
        maps: ``(height, width)`` maps.
        position_px: ``(len(maps), m, 2)`` where to begin, px.
        radius_px: ``(m,)`` radii, px.
        profile: The discs' profile.
    """
    out = np.array(position_px, np.float64)
    window = fit_window([profile] * len(radius_px), maps[0].shape[1], REACH_PX)
    pixels, curves = window.pixels, window.curves(ITERATIONS)
    outline_px = round_outline(radius_px)
    for values, center in zip(maps, out, strict=True):
        padded = np.pad(values, PAD_PX, constant_values=OUTSIDE_LEVEL)
        fit_discs_kernel(
            padded,
            center,
            outline_px,
            pixels,
            curves,
            (center, 0.0),
            (radius_px, 0.0, 0.0),
            np.zeros(len(center)),
        )
    return out
