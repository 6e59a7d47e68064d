"""Which recordings are unlike the others, and in which figure.

Source: Iglewicz and Hoaglin, "How to Detect and Handle Outliers" (1993): the modified z-score with
the median absolute deviation, and with the mean one where more than half of the values are equal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from spikingtac.batch.job import Figure

LIMIT = 3.5
"""Modified z-score above which a value is an outlier (Iglewicz and Hoaglin)."""
MEDIAN_SHARE, MEAN_SHARE = 1.4826, 1.2533
"""Standard deviation of a normal distribution over its median and its mean absolute deviation."""
LEAST = 5
"""Recordings below which nothing is called unlike the rest."""


def scores(column: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the modified z-score of each value, without sign; 0 where all are equal.

    Args:
        column: ``(n,)`` values; NaN where there is none, whose score is 0.
    """
    known = column[np.isfinite(column)]
    if len(known) < LEAST:
        return np.zeros(len(column))
    away = np.abs(column - np.median(known))
    spread = MEDIAN_SHARE * np.median(np.abs(known - np.median(known)))
    if spread == 0.0:
        spread = MEAN_SHARE * np.mean(np.abs(known - np.median(known)))
    return np.nan_to_num(away / spread) if spread > 0.0 else np.zeros(len(column))


def unlike(rows: Sequence[Mapping[str, Figure]]) -> list[dict[str, float]]:
    """Return for each row the figures that are outliers, with their scores, the largest first."""
    names = dict.fromkeys(name for row in rows for name in row)
    found: list[dict[str, float]] = [{} for _ in rows]
    for name in names:
        column = np.array([_number(row.get(name)) for row in rows], np.float64)
        for number, score in enumerate(scores(column)):
            if score > LIMIT:
                found[number][name] = round(float(score), 2)
    return [dict(sorted(one.items(), key=lambda item: -item[1])) for one in found]


def _number(value: Figure) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")
