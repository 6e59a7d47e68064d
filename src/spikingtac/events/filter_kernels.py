"""Numba kernels of the event filters."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

ONE, TWO = np.uint64(1), np.uint64(2)
"""Unsigned, so that no index can be meant from the end."""


@njit(cache=True, nogil=True)
def supported_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    t: NDArray[np.int64],
    window_us: int,
    last_us: NDArray[np.int64],
    kept: tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_], NDArray[np.int64]],
) -> int:
    """Copy the events that a neighbour fired before within the window; return how many.

    Args:
        x: Columns, px.
        y: Rows, px.
        p: Polarities.
        t: Times, us, in order.
        window_us: Length of the window.
        last_us: ``(height + 2, width + 2)`` time of each pixel's last event; updated.
        kept: Where to write their columns, rows, polarities and times; as long as ``x``.
    """
    kept_x, kept_y, kept_p, kept_t = kept
    count = 0
    for i in range(len(t)):
        row, column = np.uint64(y[i]), np.uint64(x[i])
        # All eight are looked at: no processor can foresee which of them fired, and a wrong guess
        # costs more than the look. So does writing only what is kept.
        newest = max(last_us[row, column], last_us[row, column + ONE])
        newest = max(newest, last_us[row, column + TWO])
        newest = max(newest, last_us[row + ONE, column], last_us[row + ONE, column + TWO])
        newest = max(newest, last_us[row + TWO, column], last_us[row + TWO, column + ONE])
        newest = max(newest, last_us[row + TWO, column + TWO])
        kept_x[count], kept_y[count], kept_p[count], kept_t[count] = x[i], y[i], p[i], t[i]
        count += newest >= t[i] - window_us
        last_us[row + ONE, column + ONE] = t[i]
    return count
