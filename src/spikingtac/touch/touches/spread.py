"""How far the markers have moved: the farthest, and most of them from what all share."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.touch.field.selection import select_kernel

Field = NDArray[np.float64]


@njit(cache=True, nogil=True)
def spread_kernel(away: Field, share: float) -> tuple[float, float]:
    """Return the largest displacement, and within which distance of the common one a share lies.

    Args:
        away: ``(m, 2)`` displacements; the common one is their median, axis by axis.
        share: Share of the markers, below 1.
    """
    markers = len(away)
    distance, largest = np.empty(markers), 0.0
    for marker in range(markers):
        distance[marker] = away[marker, 0]
    x = select_kernel(distance, markers // 2)
    for marker in range(markers):
        distance[marker] = away[marker, 1]
    y = select_kernel(distance, markers // 2)
    for marker in range(markers):
        largest = max(largest, away[marker, 0] ** 2 + away[marker, 1] ** 2)
        distance[marker] = (away[marker, 0] - x) ** 2 + (away[marker, 1] - y) ** 2
    return np.sqrt(largest), np.sqrt(select_kernel(distance, int(share * markers)))
