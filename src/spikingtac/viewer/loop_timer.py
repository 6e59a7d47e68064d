"""Pacing of a live loop: periods, overruns and step times."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

WINDOW_STEPS = 4096
"""Step times kept for the percentiles: 4 s at 1 kHz; the counters cover the whole run."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LoopReport:
    """How a loop kept its time.

    Attributes:
        steps: Steps that were run.
        overruns: Steps that ended after their period.
        p50_us: Median duration of the recent steps, us.
        p99_us: 99th percentile of the same, us.
        worst_us: Longest step of the whole run, us.
    """

    steps: int
    overruns: int
    p50_us: float
    p99_us: float
    worst_us: float


class LoopTimer:
    """Runs a loop at a steady period; a late step delays the loop, no burst makes up for it.

    Example:
        >>> timer = LoopTimer(period_s=0.001)
        >>> for _ in range(3):
        ...     timer.begin()
        ...     timer.end()
        ...     timer.wait()
        >>> timer.report().steps
        3
    """

    def __init__(
        self,
        *,
        period_s: float,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Prepare a loop.

        Args:
            period_s: Length of a step, s.
            clock: Monotonic seconds.
            sleep: Waits the given seconds.

        Raises:
            ValueError: The period is not positive.
        """
        if period_s <= 0:
            raise ValueError(f"period_s is {period_s}, it must be positive")
        self._period_s, self._clock, self._sleep = period_s, clock, sleep
        self._deadline_s: float | None = None
        self._begun_s = 0.0
        self._recent_s: deque[float] = deque(maxlen=WINDOW_STEPS)
        self._steps = self._overruns = 0
        self._worst_s = 0.0

    def begin(self) -> None:
        """Mark the start of a step's work."""
        self._begun_s = self._clock()
        if self._deadline_s is None:
            self._deadline_s = self._begun_s + self._period_s

    def end(self) -> None:
        """Mark the end of a step's work."""
        spent_s = self._clock() - self._begun_s
        self._recent_s.append(spent_s)
        self._worst_s = max(self._worst_s, spent_s)
        self._steps += 1

    def wait(self) -> None:
        """Sleep until the next period; count an overrun where it has begun already."""
        now_s = self._clock()
        deadline_s = now_s if self._deadline_s is None else self._deadline_s
        if now_s > deadline_s:
            self._overruns += 1
            self._deadline_s = now_s + self._period_s
            return
        self._sleep(deadline_s - now_s)
        self._deadline_s = deadline_s + self._period_s

    @property
    def overruns(self) -> int:
        """Steps that ended after their period, so far."""
        return self._overruns

    def report(self) -> LoopReport:
        """Return the counters and percentiles so far."""
        recent_us = np.array(self._recent_s or [0.0]) * 1e6
        p50_us, p99_us = np.percentile(recent_us, (50, 99))
        return LoopReport(
            steps=self._steps,
            overruns=self._overruns,
            p50_us=float(p50_us),
            p99_us=float(p99_us),
            worst_us=self._worst_s * 1e6,
        )
