"""Numba kernels of the event filters."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def supported_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    t: NDArray[np.int64],
    window_us: int,
    last_us: NDArray[np.int64],
    keep: NDArray[np.bool_],
) -> None:
    """Mark the events that a neighbour fired before within the window.

    Args:
        x: Columns, px.
        y: Rows, px.
        t: Times, us, in order.
        window_us: Length of the window.
        last_us: ``(height + 2, width + 2)`` time of each pixel's last event; updated.
        keep: Where to write the marks.
    """
    for i in range(len(t)):
        row, column = np.int64(y[i]) + 1, np.int64(x[i]) + 1
        # All eight are looked at: no processor can foresee which of them fired, and a wrong guess
        # costs more than the look.
        above = max(last_us[row - 1, column - 1], last_us[row - 1, column])
        above = max(above, last_us[row - 1, column + 1])
        beside = max(last_us[row, column - 1], last_us[row, column + 1])
        below = max(last_us[row + 1, column - 1], last_us[row + 1, column])
        below = max(below, last_us[row + 1, column + 1])
        keep[i] = max(above, beside, below) >= t[i] - window_us
        last_us[row, column] = t[i]
