"""Numba kernel of the Event Stream decoder."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def decode_kernel(
    data: NDArray[np.uint8],
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    p: NDArray[np.bool_],
    t: NDArray[np.int64],
    state: NDArray[np.int64],
) -> tuple[Any, Any]:
    """Decode whole events; return their number and the bytes used. ``state`` is the time, us."""
    n, i = 0, 0
    while i < len(data):
        first = np.int64(data[i])
        if first == 0xFF:
            state[0] += 127
            i += 1
        elif first == 0xFE:
            i += 1
        elif i + 5 <= len(data):
            state[0] += first >> 1
            x[n] = np.int64(data[i + 1]) | (np.int64(data[i + 2]) << 8)
            y[n] = np.int64(data[i + 3]) | (np.int64(data[i + 4]) << 8)
            p[n], t[n] = (first & 1) == 1, state[0]
            n += 1
            i += 5
        else:
            break
    return n, i
