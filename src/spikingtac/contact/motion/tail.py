"""Extrapolate the value that is exceeded once in a stated time from a much shorter recording."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

TAIL_SHARES = (0.05, 0.02, 0.01)
"""Shares of the highest blocks that make the tail. Rare swings of an arm stand out from the noise
of the pixels only in the outermost blocks. Each share gives a threshold; the highest is taken."""
WHOLE_TAIL, LEAST_TAIL = 10, 6
"""Fewest blocks of the first share, which a short recording uses too, and of the other shares.
Their mean excess is known to a third and to two fifths."""
STANDARD_ERRORS = 2.0
"""The mean excess is raised by this many of its standard errors (ours)."""


def tail_threshold(values: NDArray[np.float64], block: int, per_block: float) -> float:
    """Return the value that a block's highest value exceeds with a small probability.

    The excess of the blocks' maxima over a high quantile is taken as exponential (Pickands, Ann.
    Statist. 3, 1975, with shape 0). For an amplitude of Gaussian origin, such as that of a
    vibration, this overstates the tail; where noise makes most of the maxima and something else the
    highest, one quantile would understate it, so that several are tried. The mean excess is raised
    by two standard errors: a short recording gives a high threshold, not a wrong one.

    Args:
        values: An amplitude at consecutive times.
        block: Length of a block; values further apart are taken as independent.
        per_block: The probability.

    Returns:
        The threshold; infinity where there are fewer than two blocks.
    """
    blocks = len(values) // block
    peaks = np.sort(values[: blocks * block].reshape(blocks, block).max(axis=1))
    whole = min(max(round(TAIL_SHARES[0] * blocks), WHOLE_TAIL), blocks - 1)
    if whole < 1:
        return math.inf
    further = [round(share * blocks) for share in TAIL_SHARES[1:]]
    tails = [whole, *(tail for tail in further if tail >= LEAST_TAIL)]
    return max(_extrapolated(peaks, tail, per_block) for tail in tails)


def _extrapolated(peaks: NDArray[np.float64], tail: int, per_block: float) -> float:
    """Return the threshold that the highest ``tail`` of the sorted peaks give."""
    level = float(peaks[-tail - 1])
    excess = float(peaks[-tail:].mean()) - level
    excess *= 1.0 + STANDARD_ERRORS / math.sqrt(tail)
    return level + excess * math.log(max(tail / len(peaks) / per_block, 1.0))
