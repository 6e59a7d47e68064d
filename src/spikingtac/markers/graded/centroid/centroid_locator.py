"""Locate markers by the centroid of the graded map around each: for 10 kHz (preset ``fast``).

What it gives up against the disc fit: the robust weights, and with them accuracy under noise.
A disc that the border cuts has its centroid beside its centre, which is corrected for
(:mod:`spikingtac.markers.graded.centroid.cut_discs`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.markers.edge_equations import SAME_BITS
from spikingtac.markers.graded.appearance import appearance_of
from spikingtac.markers.graded.centroid.cut_discs import cut_discs, uncut_kernel
from spikingtac.markers.graded.disc_fit import round_outline
from spikingtac.markers.graded.initial_map import painted_graded_map
from spikingtac.state_map.graded import PAD_PX, GradedStateMap


@dataclass(frozen=True, kw_only=True, slots=True)
class CentroidLocatorConfig:
    """Settings of the centroid.

    Attributes:
        reach_px: Margin of the window outside of the largest disc, px (ours).
        floor: Level up to which pixels count as ground: a stray ON event is not yet marker (ours).
    """

    reach_px: float = field(default=3.0, metadata={"range": (0.5, 6.0)})
    floor: float = field(default=0.25, metadata={"range": (0.0, 0.9)})

    def __post_init__(self) -> None:
        if not self.reach_px > 0.0:
            raise ConfigError(f"reach_px is {self.reach_px}, it must be positive")
        if not 0.0 <= self.floor < 1.0:
            raise ConfigError(f"floor is {self.floor}, it must lie in [0, 1)")


BLOCK_PX = 32
"""Pixels of a row that are summed at a time: four registers of eight."""


class CentroidLocator:
    """Local centroids, all markers at once."""

    def __init__(self, config: CentroidLocatorConfig, calibration: Calibration) -> None:
        """Choose the window, and weigh every marker at rest for its agreement later."""
        self._floor = np.float32(config.floor)
        self.outline_px = round_outline(calibration.radius_px)
        window_px = float(calibration.radius_px.max()) + config.reach_px
        self._window = round_window(window_px)
        self._mass = np.ones(len(calibration.radius_px))
        self._agreement = np.ones(len(calibration.radius_px))
        appearance = appearance_of(calibration)
        cut = cut_discs(calibration.radius_px, appearance.profiles, window_px, config.floor)
        self._cut = cut.center_px, cut.whole
        painted = painted_graded_map(calibration, appearance)
        self._centroids(painted, calibration.reference_px.copy())
        self._full_mass = np.maximum(self._mass, 1.0)

    @property
    def needs_expectation(self) -> bool:
        """False: a centroid has no use for the neighbours' prediction."""
        return False

    @property
    def largest_fall(self) -> float:
        """Any: the mass above the floor falls in each fast motion, without a loss."""
        return float("inf")

    def locate(
        self,
        state_map: GradedStateMap,
        predicted_px: NDArray[np.float64],
        expected_px: NDArray[np.float64] | None,
        dt_s: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ``(m, 2)`` centres, px, and ``(m,)`` agreement with the map, 0 to 1."""
        center_px = predicted_px.copy()
        self._centroids(state_map, center_px)
        _agreement_kernel(self._mass, self._full_mass, self._agreement)
        return center_px, self._agreement

    def initial_map(self, calibration: Calibration) -> GradedStateMap:
        """Return the graded map of the sensor at rest."""
        return painted_graded_map(calibration, appearance_of(calibration))

    def reset(self) -> None:
        """Do nothing: a centroid remembers nothing."""

    def _centroids(self, state_map: GradedStateMap, center_px: NDArray[np.float64]) -> None:
        _centroids_kernel(
            state_map.padded, center_px, self._window, self._floor, self._cut, self._mass
        )


def round_window(radius_px: float) -> NDArray[np.float32]:
    """Return ``(rows, n)`` the weights of a disc's pixels, from its middle row on.

    A row serves for the one above the middle and for the one below, so that the middle row, which
    is both, counts half. Column n / 2 is the central one; n is a multiple of BLOCK_PX.

    Args:
        radius_px: Cut to what the margin of the map allows, px.
    """
    radius_px = min(radius_px, PAD_PX - 1.0)
    blocks = -(-(2 * int(radius_px) + 2) // BLOCK_PX)
    columns = np.arange(blocks * BLOCK_PX) - blocks * BLOCK_PX // 2
    rows = np.arange(int(radius_px) + 1)[:, np.newaxis]
    weight = (np.hypot(columns, rows) <= radius_px).astype(np.float32)
    weight[0] /= 2.0
    return weight


@njit(cache=True, nogil=True)
def _agreement_kernel(
    mass: NDArray[np.float64], full: NDArray[np.float64], agreement: NDArray[np.float64]
) -> None:  # pragma: no cover - compiled
    """Set the ratio of each mass to that at rest, or its inverse where that is smaller."""
    for m in range(mass.size):
        share = mass[m] / full[m]
        agreement[m] = min(share, 1.0 / max(share, 0.1))


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def _above_floor_kernel(a: Any, b: Any, floor: Any, weight: Any) -> tuple[Any, Any]:
    """Return sum and difference of two pixels' levels above the floor, times their weight."""
    zero = np.float32(0.0)
    a, b = a - floor, b - floor
    a, b = (a if a > zero else zero), (b if b > zero else zero)
    return (a + b) * weight, (b - a) * weight


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def _moment_kernel(mass: Any, j: Any) -> Any:
    """Return the moment of a mass about column 0 of its block."""
    return mass * np.float32(np.int32(j))


@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz"}, error_model="numpy", forceinline=True)
def _moments_kernel(
    flat: NDArray[np.float32], middle: int, row_px: int, weight: NDArray[np.float32], floor: Any
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Return the sum of what lies above the floor, and its first moments about ``middle``.

    Levels above the floor are multiples of its last bit, so that their sums are exact in double
    precision, in whichever order the compiler takes them. The innermost loop has a length that it
    knows, and no remainder: loops of 21 pixels would cost more by their ends than by what they do.
    """
    half = np.uint64(weight.shape[1] // 2)
    total = sum_x = sum_y = 0.0
    for i in range(weight.shape[0]):
        above, below = np.uint64(middle - i * row_px) - half, np.uint64(middle + i * row_px) - half
        for first in range(np.uint64(0), np.uint64(weight.shape[1]), np.uint64(BLOCK_PX)):
            mass = moment = tilt = 0.0
            for j in range(np.uint64(BLOCK_PX)):
                both, unlike = _above_floor_kernel(
                    flat[above + first + j], flat[below + first + j], floor, weight[i, first + j]
                )
                mass += np.float64(both)
                moment += np.float64(_moment_kernel(both, j))
                tilt += np.float64(unlike)
            total += mass
            sum_x += moment + mass * float(np.int64(first) - np.int64(half))
            sum_y += tilt * float(i)
    return total, sum_x, sum_y


@njit(cache=True, nogil=True)
def _centroids_kernel(
    padded: NDArray[np.float32],
    center_px: NDArray[np.float64],
    window: NDArray[np.float32],
    floor: np.float32,
    cut: tuple[NDArray[np.float64], NDArray[np.float64]],
    mass: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Move every centre to where its disc is whose centroid lies around its nearest pixel.

    ``cut`` are the tables of :class:`CutDiscs`. ``mass`` is what a whole disc would show.
    """
    row_px = padded.shape[1]
    last_column, last_row = row_px - 2 * PAD_PX - 1, padded.shape[0] - 2 * PAD_PX - 1
    flat = padded.ravel()
    for m in range(center_px.shape[0]):
        column = min(max(int(np.rint(center_px[m, 0])), 0), last_column)
        row = min(max(int(np.rint(center_px[m, 1])), 0), last_row)
        middle = (row + PAD_PX) * row_px + column + PAD_PX
        total, sum_x, sum_y = _moments_kernel(flat, middle, row_px, window, floor)
        mass[m] = total
        if total > 1.0:
            x, more_x = uncut_kernel(column + sum_x / total, last_column, cut[0][m], cut[1][m])
            y, more_y = uncut_kernel(row + sum_y / total, last_row, cut[0][m], cut[1][m])
            center_px[m, 0], center_px[m, 1] = x, y
            mass[m] = total * more_x * more_y
