"""Which value is exceeded once in a stated time, from a recording that is much shorter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TAIL_SHARE = 0.02
"""The highest 2 % of the values make the tail."""
LEAST_TAIL = 10
"""With fewer separate excesses a mean excess is worth nothing."""


def tail_threshold(values: NDArray[np.float64], chance: float, spacing: int) -> float:
    """Return the value that is exceeded with a small probability at any one time.

    The excess over a high quantile is taken as exponential, the limit for Gaussian and Poisson sums
    (Pickands, Ann. Statist. 3, 1975, with shape 0). Excesses closer together than ``spacing``
    belong to one burst, of which the highest counts; the mean excess is raised by two standard
    errors, so that a short recording gives a high threshold, not a false one.

    Args:
        values: Statistics of consecutive windows without contact.
        chance: The probability, far below ``1 / len(values)``.
        spacing: Windows over which the statistic remembers.

    Returns:
        The threshold; infinity where the recording has too few separate excesses.
    """
    level = float(np.quantile(values, 1.0 - TAIL_SHARE))
    above = np.flatnonzero(values > level)
    if len(above) == 0:
        return float("inf")
    begins = np.concatenate([[True], np.diff(above) > spacing])
    groups = np.cumsum(begins) - 1
    peaks = np.full(groups[-1] + 1, -np.inf)
    np.maximum.at(peaks, groups, values[above])
    if len(peaks) < LEAST_TAIL:
        return float("inf")
    excess = float((peaks - level).mean()) * (1.0 + 2.0 / np.sqrt(len(peaks)))
    rate = len(peaks) / len(values)
    return level + excess * float(np.log(max(rate / chance, 1.0)))
