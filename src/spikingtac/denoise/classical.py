"""The denoisers by name; those without a network: none, a 3x3 median and a 7x7 box.

The paper compares its network with nothing. These filters are the reference that a network has to
improve on. On a binary map the median is the majority of nine pixels. Beyond the border both
filters repeat the nearest pixel of the map (``mode="nearest"`` of scipy.ndimage), so that a marker
at the border keeps its level.
"""

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import named
from spikingtac.state_map.graded import Array

# Pixels on each side of the centre of the 7x7 box: about half a marker's radius on 320x320.
BOX_REACH = 3


class Denoiser(Protocol):
    """Turns a noisy state map into a denoised one of the same shape."""

    def clean(self, state_map: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the denoised map.

        Args:
            state_map: ``(height, width)`` float32 from 0 (ground) to 1 (marker).

        Returns:
            ``(height, width)`` float32 from 0 to 1. The next call may overwrite it.
        """
        ...


class NoDenoiser:
    """Returns the map unchanged."""

    def clean(self, state_map: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the given array itself."""
        return state_map


class Median3:
    """The median of each pixel's 3x3 neighbourhood: removes lone pixels, keeps edges.

    Example:
        >>> import numpy as np
        >>> lone = np.zeros((5, 5), np.float32)
        >>> lone[2, 2] = 1.0
        >>> float(Median3().clean(lone).max())
        0.0
    """

    def clean(self, state_map: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the median map of a ``(height, width)`` float32 one."""
        out = np.empty(state_map.shape, np.float32)
        _median3_kernel(state_map, out, np.empty((3, state_map.shape[1] + 2), np.float32))
        return out


class Box7:
    """The mean of each pixel's 7x7 neighbourhood: strongest against noise, blurs edges evenly.

    Example:
        >>> import numpy as np
        >>> round(float(Box7().clean(np.eye(7, dtype=np.float32))[3, 3]), 4)
        0.1429
    """

    def clean(self, state_map: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the mean map of a ``(height, width)`` float32 one."""
        out = np.empty(state_map.shape, np.float32)
        _box7_kernel(state_map, out, np.empty(state_map.shape[1] + 2 * BOX_REACH, np.float32))
        return out


# Name in the ``denoise`` experiment -> class; none of them has anything to set.
CLASSICAL_DENOISERS: dict[str, type[Denoiser]] = {
    "none": NoDenoiser,
    "median3": Median3,
    "box7": Box7,
}


def _network(name: str) -> Denoiser:
    from spikingtac.denoise.infer import shipped_denoiser  # with ONNX Runtime behind it

    return shipped_denoiser(name)


# ``tracking.denoiser`` -> builder.
DENOISERS: dict[str, Callable[[], Denoiser]] = {
    **CLASSICAL_DENOISERS,
    **{name: partial(_network, name) for name in ("network", "network-int8")},
}


def make_denoiser(name: str) -> Denoiser:
    """Build the denoiser of a name."""
    return named(DENOISERS, name, "denoiser")()


# The comparisons are spelled out because Numba's min and max honour NaN, which keeps LLVM from
# turning these loops into vector code.
@njit(cache=True, inline="always")
def _smaller(a: float, b: float) -> float:
    return a if a < b else b


@njit(cache=True, inline="always")
def _larger(a: float, b: float) -> float:
    return a if a > b else b


@njit(cache=True, inline="always")
def _middle(a: float, b: float, c: float) -> float:
    return _larger(_smaller(a, b), _smaller(_larger(a, b), c))


@njit(cache=True)
def _median3_kernel(state_map: Array, out: Array, columns: Array) -> None:
    # The median of nine is the median of (largest of the column minima, median of the column
    # medians, smallest of the column maxima): each column is sorted once, not three times.
    height, width = state_map.shape
    low, middle, high = columns[0], columns[1], columns[2]
    for y in range(height):
        above, here = state_map[max(y - 1, 0)], state_map[y]
        below = state_map[min(y + 1, height - 1)]
        for x in range(width):
            a, b, c = above[x], here[x], below[x]
            low[x + 1] = _smaller(_smaller(a, b), c)
            middle[x + 1] = _middle(a, b, c)
            high[x + 1] = _larger(_larger(a, b), c)
        for column in columns:
            column[0] = column[1]
            column[width + 1] = column[width]
        row = out[y]
        for x in range(width):
            largest_low = _larger(_larger(low[x], low[x + 1]), low[x + 2])
            smallest_high = _smaller(_smaller(high[x], high[x + 1]), high[x + 2])
            row[x] = _middle(
                largest_low, _middle(middle[x], middle[x + 1], middle[x + 2]), smallest_high
            )


@njit(cache=True)
def _box7_kernel(state_map: Array, out: Array, sums: Array) -> None:
    # Seven additions per axis instead of a running sum: they run as vector code, and no rounding
    # error accumulates from pixel to pixel. Written out, because an inner loop is not vectorised.
    height, width = state_map.shape
    reach = BOX_REACH
    weight = np.float32(1.0 / (2 * reach + 1) ** 2)
    for y in range(height):
        up3, up2, up1 = state_map[max(y - 3, 0)], state_map[max(y - 2, 0)], state_map[max(y - 1, 0)]
        here, last = state_map[y], height - 1
        down1, down2 = state_map[min(y + 1, last)], state_map[min(y + 2, last)]
        down3 = state_map[min(y + 3, last)]
        for x in range(width):
            upper = up3[x] + up2[x] + up1[x]
            sums[x + reach] = upper + here[x] + down1[x] + down2[x] + down3[x]
        for x in range(reach):
            sums[x] = sums[reach]
            sums[width + reach + x] = sums[width + reach - 1]
        row = out[y]
        for x in range(width):
            left = sums[x] + sums[x + 1] + sums[x + 2]
            right = sums[x + 4] + sums[x + 5] + sums[x + 6]
            row[x] = weight * (left + sums[x + 3] + right)
