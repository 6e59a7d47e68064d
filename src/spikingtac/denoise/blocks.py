"""Conversion of a map to blocks and back: the pixel-unshuffle outside of the network's graph.

Channel ``fold * row + column`` of a block holds that pixel of it, in the order of
``torch.nn.PixelUnshuffle``. Sides that are not a multiple of the block are padded with the last
pixels of the map. The int8 network reads and writes bytes, in blocks as rows of channels,
``(rows, columns, channels)``, so that one row of a block is one machine word.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.state_map.graded import Array

LEVELS = 255  # Byte of level 1.
SMOOTH_SUM = 256  # Sum of the 25 weights of :func:`smooth_kernel`.
SMOOTH_REACH = 2  # Number of pixels on each side of the centre of the smoothing kernel.
LOGIT_LIMIT = 4.0  # Logit beyond which the level is 0 or 1.

# Side of a block, px -> type of the machine word that holds one of its rows.
WORDS: dict[int, Any] = {1: np.uint8, 2: np.uint16, 4: np.uint32, 8: np.uint64}


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


def fold_blocks(state_map: NDArray[Any], fold: int, multiple_px: int) -> NDArray[Any]:
    """Return the blocks ``(fold^2, rows, columns)`` of a map ``(height, width)``, padded."""
    pixels, rows, columns = folded_shape(state_map.shape, fold, multiple_px)
    height, width = state_map.shape
    more = (0, rows * fold - height), (0, columns * fold - width)
    padded = np.pad(state_map, more, mode="edge").reshape(rows, fold, columns, fold)
    return padded.transpose(1, 3, 0, 2).reshape(pixels, rows, columns)


def unfold_blocks(folded: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return the map of a size ``(height, width)`` of its blocks; cut the padding."""
    pixels, rows, columns = folded.shape
    fold = math.isqrt(pixels)
    whole = folded.reshape(fold, fold, rows, columns).transpose(2, 0, 3, 1)
    return whole.reshape(rows * fold, columns * fold)[: size[0], : size[1]]


@njit(cache=True)
def quantise_kernel(state_map: Array, levels: Array) -> None:
    """Write a map ``(height, width)`` from 0 to 1 as bytes, padded to the bytes' shape."""
    height, width = state_map.shape
    rows, columns = levels.shape
    whole, half = np.float32(LEVELS), np.float32(0.5)
    for y in range(height):
        source, target = state_map[y], levels[y]
        for x in range(width):
            target[x] = np.uint8(np.int32(source[x] * whole + half))
        for x in range(width, columns):
            target[x] = target[width - 1]
    for y in range(height, rows):
        levels[y] = levels[height - 1]


@njit(cache=True)
def smooth_kernel(levels: Array, smooth: Array, sums: Array) -> None:
    """Sum 5x5 pixels with the binomial weights 1 4 6 4 1, which add up to SMOOTH_SUM.

    The pixels of the border are repeated beyond it.

    Args:
        levels: ``(height, width)`` bytes or float32.
        smooth: ``(height, width)`` sums, overwritten: uint16 (of bytes at most 65,280) or float32.
        sums: ``(width + 4,)`` work space of the same type for the sums along a column.
    """
    height, width = levels.shape
    last = height - 1
    for y in range(height):
        up2, up1, here = levels[max(y - 2, 0)], levels[max(y - 1, 0)], levels[y]
        down1, down2 = levels[min(y + 1, last)], levels[min(y + 2, last)]
        for x in range(width):
            sums[x + 2] = (up2[x] + down2[x]) + 4 * (up1[x] + down1[x]) + 6 * here[x]
        sums[0] = sums[1] = sums[2]
        sums[width + 2] = sums[width + 3] = sums[width + 1]
        row = smooth[y]
        for x in range(width):
            row[x] = (sums[x] + sums[x + 4]) + 4 * (sums[x + 1] + sums[x + 3]) + 6 * sums[x + 2]


@njit(cache=True)
def combine_logits_kernel(
    change: Array,
    trust: Array,
    smooth: Array,
    quantum: tuple[float, float],
    weight: Array,
    out: Array,
) -> None:
    """Add the weighted smoothed map to the network's logits and convert the sum to levels.

    The logistic function is approximated by 1/2 + v/4 - v|v|/32 between -4 and 4: exact at 0, error
    at most 0.022, two thirds of the time of a table.

    Args:
        change: ``(height, width)`` quantised logits.
        trust: ``(rows, columns)`` quantised weight of the smoothed map per block; negative weights
            count as 0.
        smooth: ``(height, width)`` result of :func:`smooth_kernel`.
        quantum: Logit of one step, and the byte of logit 0.
        weight: ``(width,)`` work space for the weights of a row's pixels.
        out: ``(height, width)`` levels, overwritten; smaller than the padded inputs.
    """
    height, width = out.shape
    fold = change.shape[0] // trust.shape[0]
    step, zero = np.float32(quantum[0]), np.float32(quantum[1])
    scale = np.float32(1.0 / (LEVELS * SMOOTH_SUM))
    nothing, half = np.float32(0.0), np.float32(0.5)
    slope, curvature = np.float32(1.0 / LOGIT_LIMIT), np.float32(0.5 / LOGIT_LIMIT**2)
    low, high = np.float32(-LOGIT_LIMIT), np.float32(LOGIT_LIMIT)
    for y in range(height):
        if y % fold == 0:
            for column in range(trust.shape[1]):
                trusted = np.float32(trust[y // fold, column]) - zero
                trusted = step * trusted if trusted > nothing else nothing
                for x in range(column * fold, (column + 1) * fold):
                    weight[x] = trusted
        changes, smoothed, target = change[y], smooth[y], out[y]
        for x in range(width):
            evidence = np.float32(np.int32(smoothed[x])) * scale - half
            logit = step * (np.float32(np.int32(changes[x])) - zero) + weight[x] * evidence
            # Comparisons instead of min and max, which honour NaN and are no vector code.
            logit = low if logit < low else logit
            logit = high if logit > high else logit
            target[x] = half + logit * (slope - curvature * abs(logit))
