"""The play operator: what of a motion a slack string, or a pair of gears, has not yet passed on.

M. A. Krasnosel'skii and A. V. Pokrovskii, "Systems with Hysteresis", 1989
(doi:10.1007/978-3-642-61302-9). Trackers use it for fits that stay behind their markers, touches
for the beginning of a motion that an event camera does not see.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def within_play_kernel(
    x: float, y: float, play: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return how far (x, y) is from the point that follows it, at most ``play``, in any unit."""
    length2 = x * x + y * y
    if length2 > play * play:
        share = play / np.sqrt(length2)
        return x * share, y * share
    return x, y
