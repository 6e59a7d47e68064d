"""Maintenance tasks of a tracker, each at its own phase of a common period.

The phases spread the tasks over the steps: at 10,000 estimates a second, a step with two of them
would set the 99th percentile of the latency. Ours.
"""

from __future__ import annotations


class PeriodicTask:
    """One regular task: due at the first estimate, then once per period."""

    def __init__(self, period_us: int, phase: float = 0.0) -> None:
        """Begin with the task due.

        Args:
            period_us: Time between two turns, us; 0 is every estimate.
            phase: Delay of its later turns after those of a task of phase 0, as a share of the
                period.
        """
        self._period_us = period_us
        self._second_us = round(phase * period_us) or period_us
        self._due_us = -1
        self._done_us: int | None = None

    def turn_s(self, t_us: int) -> float | None:
        """Return the time since the last turn, s (0 at the first), if one is due at ``t_us``, us.

        None if none is due. A turn that is due counts as taken.
        """
        if t_us < self._due_us:
            return None
        last_us, self._done_us = self._done_us, t_us
        self._due_us = t_us + (self._second_us if last_us is None else self._period_us)
        return 0.0 if last_us is None else (t_us - last_us) * 1e-6
