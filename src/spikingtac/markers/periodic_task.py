"""What a tracker does once in a while, each chore at its own phase of a common period.

At 10,000 estimates a second the slowest step is the one that the 99th percentile tells of, so that
no step should have two chores to do. Ours.
"""

from __future__ import annotations


class PeriodicTask:
    """One regular task: due at the first estimate, then once per period."""

    def __init__(self, period_us: int, phase: float = 0.0) -> None:
        """Begin with the task due.

        Args:
            period_us: Time between two turns, us; 0 is every estimate.
            phase: Share of the period by which its later turns stand apart from those of a task
                with phase 0.
        """
        self._period_us = period_us
        self._second_us = round(phase * period_us) or period_us
        self._due_us = -1
        self._done_us: int | None = None

    def turn_s(self, t_us: int) -> float | None:
        """Return the time since the last turn, s (0 at the first), if one is due at ``t_us``, us.

        None says that none is. A turn that is due counts as taken.
        """
        if t_us < self._due_us:
            return None
        last_us, self._done_us = self._done_us, t_us
        self._due_us = t_us + (self._second_us if last_us is None else self._period_us)
        return 0.0 if last_us is None else (t_us - last_us) * 1e-6
