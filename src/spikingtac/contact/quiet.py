"""What windows without contact look like, and which count they reach once in a stated time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from spikingtac.contact.detector import Window, count_of, packets_of
from spikingtac.errors import CalibrationError

SECONDS_PER_HOUR = 3600.0
LEAST_WINDOWS = 100
"""Fewer windows do not tell a variance to 15 %."""


@dataclass(frozen=True, kw_only=True)
class QuietStatistics:
    """Counts of windows without contact.

    Attributes:
        mean: Events per window.
        variance: Of the same; above the mean where events come in bursts (an arm that shakes).
        highest: The highest count.
        windows: Number of windows.
        period_s: Length of a window, s.
    """

    mean: float
    variance: float
    highest: int
    windows: int
    period_s: float

    @classmethod
    def of(cls, windows: Iterable[Window]) -> QuietStatistics:
        """Count regular windows; record them while the arm moves, not while it rests.

        Raises:
            CalibrationError: There are fewer than 100 windows.
        """
        counts, period_us = [], 0
        for window in windows:
            counts.append(count_of(window))
            first = packets_of(window)[0]
            period_us = first.t_end_us - first.t_start_us
        if len(counts) < LEAST_WINDOWS:
            raise CalibrationError(
                f"{len(counts)} quiet windows are too few, at least {LEAST_WINDOWS} are needed; "
                "record the moving arm for longer"
            )
        values = np.array(counts)
        return cls(
            mean=float(values.mean()),
            variance=float(values.var(ddof=1)),
            highest=int(values.max()),
            windows=len(values),
            period_s=period_us * 1e-6,
        )

    def threshold(self, false_alarms_per_hour: float) -> int:
        """Return the least count that is exceeded less often than the budget.

        A negative binomial distribution with this mean and variance stands in for the counts: it is
        Poisson where the variance equals the mean, and has a longer tail where events come in
        bursts. Its tail beyond the recorded time is an extrapolation: check it on other data.

        Args:
            false_alarms_per_hour: The budget.

        Raises:
            ValueError: The budget is not positive.
        """
        from scipy import stats

        if not false_alarms_per_hour > 0.0:
            raise ValueError(f"the budget is {false_alarms_per_hour}/h, it must be positive")
        chance = false_alarms_per_hour * self.period_s / SECONDS_PER_HOUR
        mean = max(self.mean, 1.0 / self.windows)
        excess = self.variance - mean
        if excess <= mean * math.sqrt(2.0 / self.windows):
            return int(stats.poisson.isf(min(chance, 1.0), mean))
        size = mean**2 / excess
        return int(stats.nbinom.isf(min(chance, 1.0), size, size / (size + mean)))
