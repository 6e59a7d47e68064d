"""Mend damaged RAW words before they are decoded.

Three repairs, each on one chunk: find the word boundaries again where bytes were lost or inserted
(the cheapest path through the byte offsets), drop blocks that are noise, and replace single time
words that contradict their neighbours. Sound chunks never come here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.events.formats.clock import Integer

SKIP_COST = 4
"""Price of leaving out a byte, in implausible words avoided; below it, words are believed."""

BLOCK_WORDS = 64
GARBAGE_SHARE = 0.18
"""Share of undefined types above which a block is noise (random EVT3 words have 0.31)."""

NEAR_STEPS = 16
VOTERS = 4
"""Time words that are asked about a suspicious one, and how near they must be to its predecessor
to speak against it; two of them suffice."""


def aligned(
    data: NDArray[np.uint8], suspects: NDArray[np.uint8], word: np.dtype[Any]
) -> tuple[NDArray[Any], int, int]:
    """Find the word boundaries in bytes that may have lost or gained some.

    Args:
        data: ``uint8[n]``, beginning at a boundary as far as is known.
        suspects: ``uint8[n - word + 1]``, not zero where a word beginning there is implausible.
        word: Type of a word.

    Returns:
        The words (a copy), the bytes consumed, and the number of breaks found.
    """
    starts = np.empty(len(data) // word.itemsize + 1, np.int64)
    count, end, breaks = boundaries_kernel(suspects != 0, len(data), word.itemsize, starts)
    offsets = starts[:count, None] + np.arange(word.itemsize)
    return data[offsets].reshape(-1).view(word).copy(), int(end), int(breaks)


def without_garbage(words: NDArray[Any], unknown: NDArray[np.bool_]) -> tuple[NDArray[Any], int]:
    """Drop the blocks in which too many types are undefined; return the rest and their number."""
    blocks = -(-len(words) // BLOCK_WORDS)
    padded = np.zeros(blocks * BLOCK_WORDS, np.bool_)
    padded[: len(words)] = unknown
    noise = padded.reshape(blocks, BLOCK_WORDS).mean(axis=1) > GARBAGE_SHARE
    if not noise.any():
        return words, 0
    keep = ~np.repeat(noise, BLOCK_WORDS)[: len(words)]
    return words[keep], int(noise.sum())


@njit(cache=True, nogil=True)
def boundaries_kernel(
    bad: NDArray[np.bool_], length: Integer, word_bytes: int, starts: NDArray[np.int64]
) -> tuple[Any, Any, Any]:
    """Return the number of words, the end of the last one and the number of breaks."""
    cost = np.empty(length + 1, np.int32)
    skipped = np.zeros(length + 1, np.bool_)
    cost[0] = 0
    for end in range(1, length + 1):
        cost[end] = cost[end - 1] + SKIP_COST
        skipped[end] = True
        begin = end - word_bytes
        if begin >= 0 and cost[begin] + bad[begin] <= cost[end]:
            cost[end] = cost[begin] + bad[begin]
            skipped[end] = False
    end = length
    for candidate in range(max(length - word_bytes + 1, 0), length):
        if cost[candidate] < cost[end]:
            end = candidate
    position, count, breaks, skipping = end, 0, 0, False
    while position > 0:
        if skipped[position]:
            breaks += not skipping
            skipping = True
            position -= 1
        else:
            skipping = False
            position -= word_bytes
            starts[count] = position
            count += 1
    starts[:count] = starts[:count][::-1].copy()
    return count, end, breaks


@njit(cache=True, nogil=True)
def mend_high_kernel(
    value: NDArray[np.int64], wrapped: NDArray[np.bool_], last: Integer, high_bits: Integer
) -> Any:
    """Replace upper times that contradict both neighbours, in place; return how many.

    Args:
        value: Upper times in order.
        wrapped: Whether the lower time fell across each.
        last: The upper time before them, or -1.
        high_bits: Bits of the upper time.
    """
    period = np.int64(1) << high_bits
    mended = 0
    for k in range(len(value)):
        if (
            last >= 0
            and (value[k] - last) % period > 1
            and _contradicted_kernel(value, k, last, period)
        ):
            step = np.int64(wrapped[k])
            follower = (value[k + 1] - last) % period
            value[k] = (last + min(step, follower)) % period
            mended += 1
        elif last < 0 and len(value) > 2 and value[0] > value[1] and value[2] - value[1] in (0, 1):
            value[k] = value[k + 1]
            mended += 1
        last = value[k]
    return mended


@njit(cache=True, nogil=True)
def _contradicted_kernel(
    value: NDArray[np.int64], k: Integer, last: Integer, period: Integer
) -> bool:
    """Whether the followers of a time word fit its predecessor and not it."""
    if k + 1 >= len(value):
        return False
    step = (value[k] - last) % period
    follower = (value[k + 1] - last) % period
    if follower < period // 2 and follower < step:
        return True
    votes = 0
    for j in range(k + 1, min(k + 1 + VOTERS, len(value))):
        votes += (value[j] - last) % period <= NEAR_STEPS
    return step > NEAR_STEPS and votes >= 2
