"""Conversion between a state map and the int8 network: bytes and blocks of bytes.

The int8 network reads and writes blocks as rows of channels, ``(rows, columns, channels)``, so that
one row of a block is one machine word. Maps are padded with the pixels of their border.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

LEVELS = 255  # Byte of level 1.
SMOOTH_SUM = 256  # Sum of the 25 weights of :func:`smooth_kernel`.
SMOOTH_REACH = 2  # Number of pixels on each side of the centre of the smoothing kernel.
LOGIT_LIMIT = 4.0  # Logit beyond which the level is 0 or 1.

# Side of a block, px -> type of the machine word that holds one of its rows.
WORDS: dict[int, Any] = {1: np.uint8, 2: np.uint16, 4: np.uint32, 8: np.uint64}


@njit(cache=True)
def quantise_kernel(state_map: NDArray[np.float32], levels: NDArray[np.uint8]) -> None:
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
def smooth_kernel(
    levels: NDArray[np.uint8], smooth: NDArray[np.uint16], sums: NDArray[np.uint16]
) -> None:
    """Sum 5x5 bytes with the binomial weights 1 4 6 4 1, which add up to 256: at most 65,280.

    Args:
        levels: ``(height, width)`` bytes.
        smooth: ``(height, width)`` sums, overwritten.
        sums: ``(width + 4,)`` work space for the sums along a column.
    """
    height, width = levels.shape
    last = height - 1
    for y in range(height):
        up2, up1, here = levels[max(y - 2, 0)], levels[max(y - 1, 0)], levels[y]
        down1, down2 = levels[min(y + 1, last)], levels[min(y + 2, last)]
        for x in range(width):
            outer = np.uint16(up2[x]) + np.uint16(down2[x])
            inner = np.uint16(up1[x]) + np.uint16(down1[x])
            sums[x + 2] = np.uint16(outer + 4 * inner + 6 * np.uint16(here[x]))
        sums[0] = sums[1] = sums[2]
        sums[width + 2] = sums[width + 3] = sums[width + 1]
        row = smooth[y]
        for x in range(width):
            outer, inner = sums[x] + sums[x + 4], sums[x + 1] + sums[x + 3]
            row[x] = np.uint16(outer + 4 * inner + 6 * sums[x + 2])


@njit(cache=True)
def to_blocks_kernel(words: NDArray[Any], blocks: NDArray[Any]) -> None:
    """Move the words of a map ``(fold * rows, columns)`` into blocks ``(rows, columns, fold)``."""
    rows, columns, fold = blocks.shape
    for row in range(rows):
        for inside in range(fold):
            source = words[row * fold + inside]
            for column in range(columns):
                blocks[row, column, inside] = source[column]


@njit(cache=True)
def from_blocks_kernel(blocks: NDArray[Any], words: NDArray[Any]) -> None:
    """Reverse :func:`to_blocks_kernel`; further words of a block are ignored."""
    rows, columns, _ = blocks.shape
    fold = len(words) // rows
    for row in range(rows):
        for inside in range(fold):
            target = words[row * fold + inside]
            for column in range(columns):
                target[column] = blocks[row, column, inside]


@njit(cache=True)
def combine_logits_kernel(
    change: NDArray[np.uint8],
    trust: NDArray[np.uint8],
    smooth: NDArray[np.uint16],
    quantum: tuple[float, float],
    weight: NDArray[np.float32],
    out: NDArray[np.float32],
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
