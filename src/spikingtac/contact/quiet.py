"""Event counts without contact, and the count that is exceeded once in a stated time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.contact.detector import Window, count_of, packets_of
from spikingtac.errors import CalibrationError, ConfigError

SECONDS_PER_HOUR = 3600.0
BLOCK_WINDOWS = 30  # Windows of a block: half a period of the arm's vibration, 15 Hz.
CLEAR_SIGMA = 5.0  # A block this many standard deviations above others holds more than noise.

# Fewest events of a block of an even stream, and largest share by which its blocks differ.
LEAST_EVEN, EVEN_SHARE = 20, 0.5
LEAST_WINDOWS = 100  # Fewer windows determine a variance to no better than 15 %.


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
        counter = WindowCounter()
        deque(counter.counted(windows), maxlen=0)
        return counter.statistics()

    def threshold(self, false_alarms_per_hour: float) -> int:
        """Return the least count that is exceeded less often than the budget.

        A negative binomial distribution with this mean and variance models the counts: it is
        Poisson where the variance equals the mean, and has a longer tail where events come in
        bursts. Its tail beyond the recorded time is an extrapolation: check it on other data.

        Args:
            false_alarms_per_hour: The budget.

        Raises:
            ConfigError: The budget is not a positive number.
        """
        from scipy.special import betainc, pdtrc  # scipy.stats would take 0.6 s to import

        check_budget(false_alarms_per_hour)
        chance = false_alarms_per_hour * self.period_s / SECONDS_PER_HOUR
        mean = max(self.mean, 1.0 / self.windows)
        excess = self.variance - mean
        if excess <= mean * math.sqrt(2.0 / self.windows):
            return _least_count(lambda count: pdtrc(count, mean), chance)
        size = mean**2 / excess
        return _least_count(lambda count: betainc(count + 1, size, mean / (size + mean)), chance)


def _least_count(survival: Callable[[int], float], chance: float) -> int:
    """Return the least count that is exceeded with at most this chance.

    Args:
        survival: The chance that a count is exceeded; it falls with the count.
        chance: The largest chance allowed, above 0.
    """
    if chance >= 1.0:  # every window may exceed it
        return -1
    above = 1
    while survival(above - 1) > chance:
        above *= 2
    below = above // 2 - 1
    above -= 1
    while above - below > 1:
        middle = (above + below) // 2
        below, above = (middle, above) if survival(middle) > chance else (below, middle)
    return above


class WindowCounter:
    """Counts the events of the windows that pass through it."""

    def __init__(self) -> None:
        self._counts: list[int] = []
        self._period_us = 0

    def counted(self, windows: Iterable[Window]) -> Iterator[Window]:
        """Yield the windows unchanged, and count each."""
        for window in windows:
            first = packets_of(window)[0]
            # The last window of a stream may be shorter than the others.
            self._period_us = self._period_us or first.t_end_us - first.t_start_us
            self._counts.append(count_of(window))
            yield window

    def statistics(self) -> QuietStatistics:
        """Return the statistics of all windows so far.

        Raises:
            CalibrationError: There are fewer than 100 windows.
        """
        if len(self._counts) < LEAST_WINDOWS:
            raise CalibrationError(
                f"{len(self._counts)} quiet windows are too few, at least {LEAST_WINDOWS} are "
                "needed; record the moving arm for longer"
            )
        values = np.array(self._counts)
        return QuietStatistics(
            mean=float(values.mean()),
            variance=float(values.var(ddof=1)),
            highest=int(values.max()),
            windows=len(values),
            period_s=self._period_us * 1e-6,
        )


def check_budget(false_alarms_per_hour: float) -> None:
    """Refuse a budget of false alarms that is not a positive number.

    Raises:
        ConfigError: It is zero, negative, infinite or not a number.
    """
    if not 0.0 < false_alarms_per_hour < math.inf:
        raise ConfigError(
            f"the budget is {false_alarms_per_hour} false contacts per hour, it must be positive"
        )


def unsettled(count: NDArray[np.int64]) -> int:
    """Return how many of the first windows of a recording tell nothing of what follows.

    A camera may begin with a burst (its pixels settle after the start), or deliver nothing for a
    while. Blocks of a burst stand out from the later half of the blocks; a silent beginning counts
    as such where an even stream follows it, since a sensor without noise is silent too.

    Args:
        count: ``(n,)`` events of the first windows, n at least ten times :data:`BLOCK_WINDOWS`.
    """
    blocks = count[: len(count) // BLOCK_WINDOWS * BLOCK_WINDOWS].reshape(-1, BLOCK_WINDOWS)
    sums = blocks.sum(axis=1)
    later = sums[len(sums) // 2 :]
    middle = float(np.median(later))
    limit = middle + CLEAR_SIGMA * max(float(later.std()), math.sqrt(middle), 1.0)
    calm = int((sums <= limit).argmax())
    even = middle >= LEAST_EVEN and np.abs(later / max(middle, 1.0) - 1.0).max() <= EVEN_SHARE
    silent = int((count > 0).argmax()) if even else 0
    return max(calm * BLOCK_WINDOWS, silent if silent >= BLOCK_WINDOWS else 0)
