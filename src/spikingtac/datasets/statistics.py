"""Statistics of features, by episode and over all of them, with the names that LeRobot reads.

Sources: LeRobot 0.6, ``datasets/compute_stats.py``, for what is stored and how quantiles are merged
(the mean over episodes, weighted by frames: no quantile of all frames); Chan, Golub and LeVeque
(1979) for the variance. Quantiles of an episode are exact here; LeRobot estimates them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Statistics = dict[str, NDArray[np.floating] | NDArray[np.integer]]
"""Name of a statistic -> ``(k,)`` values; ``count`` is ``(1,)``."""


def statistics_of(values: NDArray[np.floating] | NDArray[np.integer]) -> Statistics:
    """Return the statistics of ``(n, k)`` values, column by column."""
    wide = values.astype(np.float64)
    quantiles = np.quantile(wide, list(QUANTILES.values()), axis=0)
    return {
        "min": wide.min(axis=0),
        "max": wide.max(axis=0),
        "mean": wide.mean(axis=0),
        "std": wide.std(axis=0),
        "count": np.array([len(wide)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def merged(parts: Sequence[Statistics]) -> Statistics:
    """Return the statistics of all frames from those of the episodes."""
    counts = np.stack([part["count"] for part in parts]).astype(np.float64)
    total = counts.sum(axis=0)
    mean = sum(part["mean"] * count for part, count in zip(parts, counts, strict=True)) / total
    variance = (
        sum(
            (part["std"] ** 2 + (part["mean"] - mean) ** 2) * count
            for part, count in zip(parts, counts, strict=True)
        )
        / total
    )
    weighed = {
        name: sum(part[name] * count for part, count in zip(parts, counts, strict=True)) / total
        for name in QUANTILES
    }
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": np.asarray(mean),
        "std": np.sqrt(np.asarray(variance)),
        "count": total.astype(np.int64),
        **{name: np.asarray(value) for name, value in weighed.items()},
    }
