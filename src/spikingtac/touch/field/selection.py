"""The value of a rank among some, as the median is."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]


@njit(cache=True, nogil=True)
def select_kernel(values: Field, rank: int) -> float:
    """Return the value of a rank, 0 for the smallest, by Hoare's selection.

    The values are reordered; doi 10.1145/366622.366647. (``np.partition`` gives the same, and takes
    seconds to compile.)
    """
    first, last = 0, len(values) - 1
    while first < last:
        pivot, i, j = values[(first + last) // 2], first, last
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if rank <= j:
            last = j
        elif rank >= i:
            first = i
        else:
            break
    return values[rank]
