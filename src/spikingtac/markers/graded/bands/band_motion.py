"""Where a marker of the band fit is expected: its motion, and how far its disc may have grown.

A marker's state is ``(9,)`` x, y (px), vx, vy (px/s), the variances of place, of place and speed,
and of speed, the same for both axes, the radius (px) and its variance.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

LEAST_GROWTH_PX = 1e-5
"""Standard deviation of a radius that is known, px: a variance is divided by."""


@njit(cache=True, nogil=True)
def predict_kernel(
    motion: NDArray[np.float64], dt_s: float, noise_px2_s3: float
) -> None:  # pragma: no cover - compiled
    """Move one marker's state on: x, y, vx, vy, and the variances (pp, pv, vv) of each axis."""
    pp, pv, vv = motion[4], motion[5], motion[6]
    motion[0] += dt_s * motion[2]
    motion[1] += dt_s * motion[3]
    motion[4] = pp + dt_s * (2.0 * pv + dt_s * vv) + noise_px2_s3 * dt_s**3 / 3.0
    motion[5] = pv + dt_s * vv + 0.5 * noise_px2_s3 * dt_s**2
    motion[6] = vv + noise_px2_s3 * dt_s


@njit(cache=True, nogil=True)
def predict_radius_kernel(
    motion: NDArray[np.float64], dt_s: float, rest_px: float, growth: tuple[float, float]
) -> None:  # pragma: no cover - compiled
    """Let one marker's radius, at 7, and its variance, at 8, return to what is known at rest."""
    share, time_s = growth
    kept, most = np.exp(-dt_s / time_s), (share * rest_px) ** 2
    motion[7] = rest_px + kept * (motion[7] - rest_px)
    motion[8] = max(most + kept * kept * (motion[8] - most), LEAST_GROWTH_PX**2)


@njit(cache=True, nogil=True)
def hold_kernel(
    motion: NDArray[np.float64], dt_s: float, settings: tuple[float, float, float]
) -> None:  # pragma: no cover - compiled
    """Let one marker rest where it is, since nothing fired: its speed fades, its variance grows."""
    stop_s, most_pp, most_vv = settings
    kept = np.exp(-dt_s / stop_s)
    motion[2] *= kept
    motion[3] *= kept
    motion[4] = min(motion[4], most_pp)
    motion[5] = 0.0
    motion[6] = min(motion[6], most_vv)
