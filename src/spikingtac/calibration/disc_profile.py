"""Edge profile of a marker's disc: its log brightness in units of the full swing.

The skin is ground (intensity 1) and disc (intensity ``contrast``), blurred by the lens: a logistic
edge of scale ``edge_px``. Event cameras see the logarithm, so that the normalised level at signed
distance q outside of the nominal radius is

    S(q) = ln(1 + k / (1 + exp(q / s))) / ln(1 + k),  k = contrast - 1, s = edge_px,

1 in the disc, 0 on the ground. At the nominal radius it is above one half, or below for a dark
disc, whose contrast is below 1.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.types import FloatArray

REACH_EDGES = 6.5  # S is within 0.005 of its limits this many edge scales to both sides of the rim.

# Entries of a table from -REACH_EDGES to +REACH_EDGES: the level changes by at most 0.02 between
# two.
TABLE_STEPS = 256

# Marker over ground intensity where nothing was calibrated (the twin's presets).
CONTRAST_DEFAULT = 6.0

# Logistic edge scale where nothing was calibrated: a pixel box with half a pixel of lens blur.
EDGE_DEFAULT_PX = 0.55


@dataclass(frozen=True)
class DiscProfile:
    """S(q) of one disc, or of many; see the module for the formula.

    Attributes:
        contrast: Intensity of the disc over that of the ground, below 1 for dark discs; one number,
            or one for each disc.
        edge_px: Logistic scale of the edge, px; the same.
    """

    contrast: Any
    edge_px: Any

    def level(self, q_px: NDArray[np.floating] | float) -> FloatArray:
        """Return S(q) for distances of any shape, px (negative inside of the disc)."""
        k = self.contrast - 1.0
        return np.log1p(k * covered(np.asarray(q_px, float) / self.edge_px)) / np.log1p(k)

    def slope(self, q_px: NDArray[np.floating] | float) -> FloatArray:
        """Return dS/dq, 1/px (negative)."""
        return -fall(np.asarray(q_px, float) / self.edge_px, self.contrast, self.edge_px)

    @property
    def steepest(self) -> Any:
        """Largest fall of the level, 1/px."""
        k = self.contrast - 1.0
        return (np.sqrt(self.contrast) - 1.0) ** 2 / (k * np.log1p(k) * self.edge_px)


def covered(z: NDArray[Any]) -> NDArray[Any]:
    """Return the share of a pixel's light that is the disc's, ``z`` edge scales outside the rim."""
    return 1.0 / (1.0 + np.exp(z.clip(-30.0, 30.0)))


def fall(z: NDArray[Any], contrast: Any, edge_px: Any) -> NDArray[Any]:
    """Return the fall of the level, 1/px, ``z`` edge scales outside the rim."""
    k, share = contrast - 1, covered(z)
    return k * share * (1.0 - share) / (1.0 + k * share) / (edge_px * np.log1p(k))


@dataclass(frozen=True)
class Discs(DiscProfile):
    """Appearance of a sensor's ``m`` markers; distances end in an axis of ``m``.

    Attributes:
        radius_px: ``(m,)`` nominal radius, px.
    """

    radius_px: FloatArray

    @classmethod
    def of(cls, calibration: Calibration) -> "Discs":
        """Return each marker's own appearance where known, else the sensor's, else a default."""
        contrast = calibration.of_each_marker("contrast", CONTRAST_DEFAULT)
        edge_px = calibration.of_each_marker("edge_px", EDGE_DEFAULT_PX)
        over_ground = 1.0 / contrast if calibration.polarity == "dark" else contrast
        return cls(over_ground, edge_px, calibration.radius_px)

    @property
    def stated_contrast(self) -> Any:
        """The contrasts as a calibration holds them: the larger intensity over the other."""
        return np.maximum(self.contrast, 1.0 / self.contrast)

    @property
    def looks(self) -> tuple[FloatArray, FloatArray, NDArray[np.float32]]:
        """Radius, edge, and levels ``(m, TABLE_STEPS)`` around the rim, for kernels."""
        z = np.linspace(-REACH_EDGES, REACH_EDGES, TABLE_STEPS)[:, np.newaxis]
        levels = DiscProfile(self.contrast, 1.0).level(z)
        return self.radius_px, self.edge_px, np.ascontiguousarray(levels.T, np.float32)


def nearest_marker(reference_px: FloatArray, size: tuple[int, int]) -> NDArray[np.int64]:
    """Return ``(height, width)`` the marker nearest to each pixel."""
    from scipy.spatial import KDTree  # 0.1 s that other verbs need not wait

    y, x = np.indices(size[::-1]).reshape(2, -1)
    _, owner = KDTree(reference_px).query(np.column_stack([x, y]))
    return np.reshape(owner, size[::-1]).astype(np.int64)


def nearest_rims(calibration: Calibration) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return for each pixel the nearest marker, the way from its centre, and from its rim, px."""
    owner = nearest_marker(calibration.reference_px, calibration.size)
    y, x = np.indices(owner.shape)
    way_px = np.stack([x, y], axis=2) - calibration.reference_px[owner]
    return owner, way_px, np.linalg.norm(way_px, axis=2) - calibration.radius_px[owner]


@njit(cache=True)
def bounds_kernel(center: float, reach: float, size: int) -> tuple[int, int]:
    """Return the first pixel and the one after the last within ``reach``, inside of the image."""
    first = max(0, int(np.floor(center - reach)))
    return first, max(first, min(size, int(np.ceil(center + reach)) + 1))


@njit(cache=True)
def level_kernel(z: Any, table: NDArray[np.float32]) -> np.float32:
    """Return the level ``z`` edge scales outside of the rim from a marker's table."""
    place = (z + REACH_EDGES) * ((TABLE_STEPS - 1) / (2.0 * REACH_EDGES))
    if place >= TABLE_STEPS - 1:
        return np.float32(0.0)
    if place <= 0.0:
        return np.float32(1.0)
    cell = int(place)
    return table[cell] + np.float32(place - cell) * (table[cell + 1] - table[cell])


@njit(cache=True)
def draw_kernel(
    place: tuple[FloatArray, FloatArray],
    looks: tuple[FloatArray, FloatArray, NDArray[np.float32]],
    image: tuple[NDArray[np.float32], NDArray[np.int32]],
    touched: NDArray[np.int64],
) -> int:
    """Draw all discs; return how many pixels were touched.

    Args:
        place: ``(m, 2)`` centres, px, and ``(m, 3)`` stretches: growth of the radius, half of its
            difference between the x and y axes, and half of its difference between the diagonals,
            px.
        looks: The arrays of :attr:`Discs.looks`.
        image: ``(height, width)`` level and owner; the owner must be -1 everywhere before.
        touched: Room for the indices of the touched pixels.
    """
    (center, stretch), (radius_px, edge_px, tables), (level, owner) = place, looks, image
    height, width = level.shape
    count = 0
    for m in range(len(radius_px)):
        radius, edge, table = radius_px[m] + stretch[m, 0], edge_px[m], tables[m]
        reach = radius + np.hypot(stretch[m, 1], stretch[m, 2]) + REACH_EDGES * edge
        top, bottom = bounds_kernel(center[m, 1], reach, height)
        left, right = bounds_kernel(center[m, 0], reach, width)
        for y in range(top, bottom):
            for x in range(left, right):
                dx, dy = x - center[m, 0], y - center[m, 1]
                square = dx * dx + dy * dy
                if square > reach * reach:
                    continue
                longer = stretch[m, 1] * (dx * dx - dy * dy) + stretch[m, 2] * 2.0 * dx * dy
                rim = radius + longer / max(square, 1e-9)
                value = level_kernel((np.sqrt(square) - rim) / edge, table)
                if owner[y, x] < 0:
                    touched[count] = y * width + x
                    count += 1
                elif value <= level[y, x]:
                    continue
                level[y, x] = value
                owner[y, x] = m
    return count
