"""Learn radii and edge width from maps of the resting skin.

The mean level of each marker over rings around its centre is compared with the profile of
:mod:`spikingtac.markers.profile`. The edge is the sensor's, radii are each marker's own.
The maps' ends may lie a little inside of 0 and 1 (the dead band of the pixels), so that the
profile's ends are fitted too, and thrown away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.profile import DiscProfile

RING_PX = 0.25
"""Width of a ring: finer than an edge, and still with a few pixels in each."""

REACH_PX = 4.0
"""Rings reach so far to both sides of the rim, px: six typical edge widths."""

ROUNDS = 8
"""Alternations between profile and radii; both stand still after five."""

BOUNDS = ((0.15, 0.7, -0.15), (2.5, 1.15, 0.3))
"""Least and largest edge (px), level inside and level outside that are believed."""

READING_LEVELS, READING_PHASES = 401, 64
"""Resolution of :func:`expected_reading` in levels and in places of a pixel's reference."""


@dataclass(frozen=True, slots=True)
class ProfileFit:
    """What the rings taught.

    Attributes:
        profile: The given contrast and the edge width found.
        radius_px: ``(m,)`` radii, px.
        residual: ``(m,)`` rms difference between a marker's rings and the profile, levels.
    """

    profile: DiscProfile
    radius_px: NDArray[np.float64]
    residual: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Model:
    contrast: float
    reading: tuple[NDArray[np.float64], NDArray[np.float64]]


def fit_profile(
    maps: list[NDArray[np.float32]],
    center_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    start: DiscProfile,
    step: float,
) -> ProfileFit:
    """Fit one edge width and a radius for each marker; the contrast is taken as given.

    The shape alone does not tell the contrast: a higher one moves the log edge outwards just as a
    larger radius does.

    Args:
        maps: ``(height, width)`` maps of the skin at rest.
        center_px: ``(len(maps), m, 2)`` where the markers are in each, px.
        radius_px: ``(m,)`` first guesses, px.
        start: The contrast, and a first guess of the edge width.
        step: Mean share of the full swing per event.
    """
    from scipy.optimize import least_squares

    distance, level, weight = _rings(maps, center_px, radius_px)
    radius = np.array(radius_px, np.float64)
    model = _Model(start.contrast, expected_reading(step))
    low, high = (np.array(bound) for bound in BOUNDS)
    found = np.array([start.edge_px, 1.0, 0.0]).clip(low + 1e-3, high - 1e-3)
    for _ in range(ROUNDS):
        q_px = distance - radius[:, np.newaxis]
        found = least_squares(
            lambda values, q_px=q_px: (
                np.sqrt(weight) * (_level(model, values, q_px) - level)
            ).ravel(),
            found,
            bounds=(low, high),
        ).x
        error = level - _level(model, found, q_px)
        slope = -_slope(model, found, q_px)
        curvature = (weight * slope**2).sum(axis=1)
        change = (weight * slope * error).sum(axis=1) / np.maximum(curvature, 1e-9)
        radius += np.clip(change, -1.0, 1.0)
    error = level - _level(model, found, distance - radius[:, np.newaxis])
    residual = np.sqrt((weight * error**2).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9))
    return ProfileFit(DiscProfile(model.contrast, float(found[0])), radius, residual)


def expected_reading(step: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what the map shows on the average (second) for true levels (first).

    A pixel's last event left its reference anywhere within a step of the light; the light then came
    to rest on its way from the ground or from the disc, both equally often. Near either end a pixel
    that turned round without an event still shows the end itself, which stretches the map.

    Args:
        step: Share of the full swing per event.
    """
    true = np.linspace(0.0, 1.0, READING_LEVELS)
    reference = (np.arange(READING_PHASES)[:, np.newaxis] + 0.5) / READING_PHASES
    rising = np.floor(true / step - reference).clip(0.0)
    from_ground = np.where(rising > 0, np.minimum((rising + 1.0) * step, 1.0), 0.0).mean(axis=0)
    return true, 0.5 * (from_ground + 1.0 - from_ground[::-1])


def _level(
    model: _Model, values: NDArray[np.float64], q_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    edge_px, inside, outside = values
    level = np.interp(DiscProfile(model.contrast, edge_px).level(q_px), *model.reading)
    return outside + (inside - outside) * level


def _slope(
    model: _Model, values: NDArray[np.float64], q_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    edge_px, inside, outside = values
    return (inside - outside) * DiscProfile(model.contrast, edge_px).slope(q_px)


def _rings(
    maps: list[NDArray[np.float32]],
    center_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    # Mean distance, mean level and pixels of each marker's rings, (m, rings) each.
    rings = int(2 * REACH_PX / RING_PX)
    sums = np.zeros((3, len(radius_px), rings))
    for values, centers in zip(maps, center_px, strict=True):
        for marker, (center, radius) in enumerate(zip(centers, radius_px, strict=True)):
            rho, level = _around(values, center, radius + REACH_PX)
            ring = np.floor((rho - radius + REACH_PX) / RING_PX).astype(int)
            inside = (ring >= 0) & (ring < rings)
            for row, amount in enumerate((np.ones_like(rho), rho, level)):
                sums[row, marker] += np.bincount(ring[inside], amount[inside], rings)
    count = np.maximum(sums[0], 1.0)
    return sums[1] / count, sums[2] / count, sums[0]


def _around(
    values: NDArray[np.float32], center: NDArray[np.float64], reach_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    height, width = values.shape
    rows = np.arange(max(0, int(center[1] - reach_px)), min(height, int(center[1] + reach_px) + 2))
    columns = np.arange(
        max(0, int(center[0] - reach_px)), min(width, int(center[0] + reach_px) + 2)
    )
    rho = np.hypot(columns[np.newaxis, :] - center[0], rows[:, np.newaxis] - center[1])
    patch = values[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return rho.ravel(), patch.astype(np.float64).ravel()
