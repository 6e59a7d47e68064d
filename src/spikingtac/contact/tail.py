"""Which value is exceeded once in a stated time, from a recording that is much shorter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

TAIL_SHARE = 0.05
"""The highest twentieth of the blocks makes the tail, but no fewer than :data:`TAIL_BLOCKS`."""
TAIL_BLOCKS = 10
"""With fewer blocks the mean excess is known to worse than a third."""
STANDARD_ERRORS = 2.0


def tail_threshold(values: NDArray[np.float64], block: int, per_block: float) -> float:
    """Return the value that a block's highest value exceeds with a small probability.

    The excess of the blocks' maxima over a high quantile is taken as exponential (Pickands, Ann.
    Statist. 3, 1975, with shape 0). For an amplitude of Gaussian origin, such as that of a
    vibration, this overstates the tail. The mean excess is raised by two standard errors, so that a
    short recording gives a high threshold, not a wrong one.

    Args:
        values: An amplitude at consecutive times.
        block: Length of a block; values further apart are taken as independent.
        per_block: The probability.

    Returns:
        The threshold; infinity where there are fewer than two blocks.
    """
    blocks = len(values) // block
    tail = min(max(round(TAIL_SHARE * blocks), TAIL_BLOCKS), blocks - 1)
    if tail < 1:
        return math.inf
    peaks = np.sort(values[: blocks * block].reshape(blocks, block).max(axis=1))
    level = float(peaks[-tail - 1])
    excess = float(peaks[-tail:].mean()) - level
    excess *= 1.0 + STANDARD_ERRORS / math.sqrt(tail)
    return level + excess * math.log(max(tail / blocks / per_block, 1.0))
