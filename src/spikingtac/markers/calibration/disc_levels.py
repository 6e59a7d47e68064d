"""Discs as the calibration's kernels draw and fit them.

See :mod:`spikingtac.calibration.disc_profile` for the formula of the level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile

# Tables reach so many edge widths to both sides of the rim; the level is within 0.01 of its ends
# there for contrasts up to 12.
REACH_EDGES = 6.0

TABLE_STEPS = 256  # Entries of a table: the level changes by at most 0.02 between two.

# The annulus of a fit: so many edge widths, and this margin, inside and outside of the rim.
INSIDE_EDGES, OUTSIDE_EDGES, MARGIN_PX = 4.5, 3.5, 1.0

# Variance of a level apart from its step's: shape and thresholds are never exact. (0.055 of a
# swing, ours: the rms of the levels that the model left over on simulated recordings.)
LEVEL_VARIANCE = 0.003

NEIGHBOURS = 8  # Nearest markers that a disc is told from.


@dataclass(frozen=True, slots=True)
class Discs:
    """How each marker looks.

    Attributes:
        radius_px: ``(m,)`` nominal radius, px.
        edge_px: ``(m,)`` logistic scale of the edge, px.
        contrast: ``(m,)`` intensity of the marker over that of its ground, above 1.
    """

    radius_px: NDArray[np.float64]
    edge_px: NDArray[np.float64]
    contrast: NDArray[np.float64]

    def with_shape(self, radius_px: NDArray[np.float64], edge_px: NDArray[np.float64]) -> Discs:
        """Return the same discs with other radii and edges."""
        return replace(self, radius_px=radius_px, edge_px=edge_px)

    @property
    def shape(self) -> NDArray[np.float64]:
        """``(m, 5)`` as kernels read it: radius and edge, px, contrast minus 1, and no stretch."""
        none = np.zeros_like(self.radius_px)
        return np.column_stack([self.radius_px, self.edge_px, self.contrast - 1.0, none, none])

    @property
    def tables(self) -> NDArray[np.float32]:
        """``(m, TABLE_STEPS)`` level from -REACH_EDGES to +REACH_EDGES edge widths."""
        z = np.linspace(-REACH_EDGES, REACH_EDGES, TABLE_STEPS)
        return np.array(
            [DiscProfile(float(contrast), 1.0).level(z) for contrast in self.contrast], np.float32
        )

    @property
    def fit_tables(self) -> NDArray[np.float32]:
        """``(m, 2, TABLE_STEPS)`` level and its fall per edge width, placed as ``tables``."""
        z = np.linspace(-REACH_EDGES, REACH_EDGES, TABLE_STEPS)
        profiles = [DiscProfile(float(contrast), 1.0) for contrast in self.contrast]
        both = [(profile.level(z), -profile.slope(z)) for profile in profiles]
        return np.array(both, np.float32).reshape(-1, 2, TABLE_STEPS)


def nearest_markers(center_px: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return ``(m, k)`` indices of each marker's nearest others, nearest first."""
    distance = np.hypot(*(center_px[:, np.newaxis] - center_px[np.newaxis]).transpose(2, 0, 1))
    count = min(NEIGHBOURS, len(center_px) - 1)
    return np.ascontiguousarray(np.argsort(distance, axis=1)[:, 1 : 1 + count])


@njit(cache=True)
def bounds_kernel(center: float, reach: float, size: int) -> tuple[int, int]:
    """Return the first pixel and the one after the last within ``reach``, inside of the image."""
    first = max(0, int(np.floor(center - reach)))
    last = min(size, int(np.ceil(center + reach)) + 1)
    return first, max(first, last)


@njit(cache=True)
def level_kernel(q_px: float, edge_px: float, table: NDArray[np.float32]) -> np.float32:
    """Return the level at a distance outside of the rim from a marker's table."""
    z = (q_px / edge_px + REACH_EDGES) * ((TABLE_STEPS - 1) / (2.0 * REACH_EDGES))
    if z >= TABLE_STEPS - 1:
        return np.float32(0.0)
    if z <= 0.0:
        return np.float32(1.0)
    cell = int(z)
    return table[cell] + np.float32(z - cell) * (table[cell + 1] - table[cell])


@njit(cache=True)
def stretched_kernel(
    shape: NDArray[np.float64], stretch: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return shapes ``(m, 5)`` that are stretched by ``(m, 3)`` px."""
    out = shape.copy()
    for m in range(len(out)):
        out[m, 0] += stretch[m, 0]
        out[m, 3], out[m, 4] = stretch[m, 1], stretch[m, 2]
    return out


@njit(cache=True)
def rim_px_kernel(shape: NDArray[np.float64], m: int, dx: Any, dy: Any) -> float:
    """Return the radius of a stretched disc in the direction of ``(dx, dy)``, px.

    Columns 3 and 4 of ``shape`` are the second harmonic of the radius: how much longer it is along
    x than along y, and along one diagonal than along the other, half of each, px.
    """
    radius, cosine, sine = shape[m, 0], shape[m, 3], shape[m, 4]
    if cosine == 0.0 and sine == 0.0:
        return radius
    square = dx * dx + dy * dy
    if square == 0.0:
        return radius
    return radius + (cosine * (dx * dx - dy * dy) + sine * 2.0 * dx * dy) / square


@njit(cache=True)
def draw_kernel(
    center: NDArray[np.float64],
    discs: tuple[NDArray[np.float64], NDArray[np.float32]],
    image: tuple[NDArray[np.float32], NDArray[np.int32]],
    touched: NDArray[np.int64],
) -> int:
    """Draw all discs; return how many pixels were touched.

    Args:
        center: ``(m, 2)`` places, px.
        discs: Shape ``(m, 5)`` and tables ``(m, TABLE_STEPS)``.
        image: ``(height, width)`` level and owner; the owner must be -1 everywhere before.
        touched: Room for the indices of the touched pixels.
    """
    shape, tables = discs
    level, owner = image
    height, width = level.shape
    count = 0
    for m in range(len(shape)):
        edge, table = shape[m, 1], tables[m]
        stretch = np.hypot(shape[m, 3], shape[m, 4])
        reach = shape[m, 0] + stretch + REACH_EDGES * edge
        inside = max(shape[m, 0] - stretch - REACH_EDGES * edge, 0.0)
        top, bottom = bounds_kernel(center[m, 1], reach, height)
        left, right = bounds_kernel(center[m, 0], reach, width)
        for y in range(top, bottom):
            for x in range(left, right):
                dx, dy = x - center[m, 0], y - center[m, 1]
                square = dx * dx + dy * dy
                if square > reach * reach:
                    continue
                value = np.float32(1.0)
                if square > inside * inside:
                    q = np.sqrt(square) - rim_px_kernel(shape, m, dx, dy)
                    value = level_kernel(q, edge, table)
                if owner[y, x] < 0:
                    touched[count] = y * width + x
                    count += 1
                elif value <= level[y, x]:
                    continue
                level[y, x] = value
                owner[y, x] = m
    return count


@njit(cache=True)
def crowded_kernel(
    m: int,
    place: NDArray[np.float64],
    reach: float,
    scene: tuple[Any, ...],
) -> bool:
    """Return whether another disc's surroundings overlap those within ``reach`` of a place."""
    center, nearest = scene[0], scene[1]
    for other in nearest[m]:
        dx, dy = center[other, 0] - place[0], center[other, 1] - place[1]
        if dx * dx + dy * dy < 4.0 * reach * reach:
            return True
    return False


@njit(cache=True)
def nearer_kernel(
    x: float,
    y: float,
    q_px: float,
    m: int,
    scene: tuple[Any, ...],
) -> bool:
    """Return whether a pixel at ``q_px`` from marker ``m``'s rim is nearer to another's rim."""
    center, nearest, shape = scene[0], scene[1], scene[2]
    for other in nearest[m]:
        limit = max(q_px + shape[other, 0], 0.0)
        if (x - center[other, 0]) ** 2 + (y - center[other, 1]) ** 2 < limit * limit:
            return True
    return False


@njit(cache=True)
def profile_kernel(z: Any, edge_px: Any, k: Any) -> tuple[float, float]:
    """Return the level at ``z`` edge widths outside of the rim, and its fall there, 1 / px."""
    cover = 1.0 / (1.0 + np.exp(max(z, -30.0)))
    light = 1.0 + k * cover
    swing = np.log1p(k)
    return np.log(light) / swing, k * cover * (1.0 - cover) / (edge_px * light * swing)


# Nearest markers whose mean motion stands for that of a marker that could not be followed.
LEADERS = 4


@dataclass(frozen=True, slots=True)
class PixelSteps:
    """What one event of each pixel stands for, shares of a full swing.

    Attributes:
        on: ``(height, width)`` float32 share of an ON event.
        off: The same for OFF events.
    """

    on: NDArray[np.float32]
    off: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Course:
    """Where the markers went.

    Attributes:
        index: ``(n,)`` how many events came before each sample.
        center_px: ``(n, m, 2)`` places, px.
        agreement: ``(n, m)`` share of each marker's edge that agreed with the fit.
        stretch_px: ``(n, m, 3)`` growth of each radius, and its second harmonic, px; None where
            discs keep their shape.
    """

    index: NDArray[np.int64]
    center_px: NDArray[np.float64]
    agreement: NDArray[np.float64]
    stretch_px: NDArray[np.float64] | None = None

    @property
    def stretches(self) -> NDArray[np.float64]:
        """``(n, m, 3)`` stretches, zeros where discs keep their shape, px."""
        if self.stretch_px is None:
            return np.zeros((*self.center_px.shape[:2], 3))
        return self.stretch_px

    def shown(self, samples: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the places ``(k, m, 2)`` and the stretches ``(k, m, 3)`` at some samples, px."""
        return self.center_px[samples], self.stretches[samples]


def led_by_neighbours(course: Course, sample: int, stuck: NDArray[np.bool_]) -> Course:
    """Return a course on which stuck markers go where the nearest others go on the average.

    Args:
        course: Where the markers went.
        sample: Where they rest, the stuck ones too.
        stuck: ``(m,)`` which markers were not followed.
    """
    rest_px, free = course.center_px[sample], np.flatnonzero(~stuck)
    center_px = course.center_px.copy()
    for marker in np.flatnonzero(stuck):
        apart_px = np.hypot(*(rest_px[free] - rest_px[marker]).T)
        leaders = free[np.argsort(apart_px, kind="stable")[:LEADERS]]
        moved_px = (course.center_px[:, leaders] - rest_px[leaders]).mean(axis=1)
        center_px[:, marker] = rest_px[marker] + moved_px
    return replace(course, center_px=center_px)
