"""Conversion of a map to blocks and back: the pixel-unshuffle outside of the network's graph.

The lean network also reads the smoothed map less one half (:func:`evidence_kernel`). Channel ``fold
* row + column`` of a block holds that pixel of it, in the order of ``torch.nn.PixelUnshuffle``.
Sides that are not a multiple of the block are padded with the last pixels of the map.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def folded_shape(shape: tuple[int, int], fold: int, multiple_px: int) -> tuple[int, int, int]:
    """Return ``(fold^2, rows, columns)`` of a map of ``(height, width)``.

    Args:
        shape: ``(height, width)``, px.
        fold: Side of a block, px.
        multiple_px: Multiple to which both sides are padded, px; itself a multiple of ``fold``.

    Example:
        >>> folded_shape((320, 320), 8, 16)
        (64, 40, 40)
    """
    height, width = (-(-side // multiple_px) * multiple_px for side in shape)
    return fold**2, height // fold, width // fold


@njit(cache=True)
def fold_kernel(state_map: NDArray[np.float32], folded: NDArray[np.float32], fold: int) -> None:
    """Write a map ``(height, width)`` into blocks ``(fold^2, rows, columns)`` and pad it."""
    height, width = state_map.shape
    _, rows, columns = folded.shape
    for y in range(rows * fold):
        source = state_map[min(y, height - 1)]
        row, first = y // fold, (y % fold) * fold
        for offset in range(fold):
            target = folded[first + offset, row]
            for column in range(columns):
                target[column] = source[min(column * fold + offset, width - 1)]


@njit(cache=True)
def evidence_kernel(
    state_map: NDArray[np.float32], evidence: NDArray[np.float32], sums: NDArray[np.float32]
) -> None:
    """Smooth 5x5 pixels with the binomial weights 1 4 6 4 1 and subtract 1/2.

    The pixels of the border are repeated beyond it.

    Args:
        state_map: ``(height, width)``.
        evidence: ``(height, width)``, overwritten.
        sums: ``(width + 4,)`` work space for the sums along a column.
    """
    height, width = state_map.shape
    last = height - 1
    scale, half = np.float32(1.0 / 256.0), np.float32(0.5)
    four, six = np.float32(4.0), np.float32(6.0)
    for y in range(height):
        up2, up1 = state_map[max(y - 2, 0)], state_map[max(y - 1, 0)]
        here = state_map[y]
        down1, down2 = state_map[min(y + 1, last)], state_map[min(y + 2, last)]
        for x in range(width):
            sums[x + 2] = up2[x] + down2[x] + four * (up1[x] + down1[x]) + six * here[x]
        sums[0] = sums[1] = sums[2]
        sums[width + 2] = sums[width + 3] = sums[width + 1]
        row = evidence[y]
        for x in range(width):
            outer, inner = sums[x] + sums[x + 4], sums[x + 1] + sums[x + 3]
            row[x] = scale * (outer + four * inner + six * sums[x + 2]) - half


@njit(cache=True)
def unfold_kernel(folded: NDArray[np.float32], state_map: NDArray[np.float32], fold: int) -> None:
    """Write blocks ``(fold^2, rows, columns)`` into a map ``(height, width)``; cut the padding."""
    # Channel by channel: a remainder and a quotient for each pixel take twenty times as long.
    height, width = state_map.shape
    for y in range(height):
        target = state_map[y]
        row, first = y // fold, (y % fold) * fold
        for offset in range(min(fold, width)):
            source = folded[first + offset, row]
            for column in range((width - offset + fold - 1) // fold):
                target[column * fold + offset] = source[column]
