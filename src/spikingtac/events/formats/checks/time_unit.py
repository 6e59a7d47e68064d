"""Seconds or microseconds? Files of numbers seldom say."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

US_PER_S = 1_000_000

SECONDS_STEP = 0.05
"""Mean step between events below which times with fractions are seconds: twenty events a second.
As microseconds it would be 20 million events a second, more than any such file holds (ours)."""

SECONDS_NOTE = "the times have fractions and are taken for seconds"


def in_seconds(t: NDArray[Any]) -> bool:
    """Return whether the times of the first events look like seconds: fractions, and small steps.

    Args:
        t: ``(n,)`` numbers of any type.
    """
    if t.dtype.kind != "f":
        return False
    times = t[np.isfinite(t)].astype(np.float64)
    if len(times) < 1 or not (times != np.rint(times)).any():
        return False
    steps = np.abs(np.diff(times))
    return float(np.median(steps)) < SECONDS_STEP if len(steps) else True
