"""How a session keeps its time, and whether its source does."""

from __future__ import annotations

import time
from collections.abc import Callable

from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig

# Waiting this long for a live source is a standstill, s; an arm is stopped after 40 ms (ours).
STALE_S = 0.5


class Pacer:
    """Runs a loop at a steady period; a late step delays the loop, no burst makes up for it.

    Args:
        period_s: Length of a step, s.

    Attributes:
        overruns: Steps that ended after their period.
    """

    def __init__(self, period_s: float) -> None:
        self.overruns = 0
        self._period_s = period_s
        self._due_s: float | None = None

    def begin(self) -> None:
        """Begin the first step."""
        if self._due_s is None:
            self._due_s = time.perf_counter() + self._period_s

    def wait(self) -> None:
        """Sleep until the next period; count an overrun where it has begun already."""
        now_s = time.perf_counter()
        due_s = now_s if self._due_s is None else self._due_s
        if now_s > due_s:
            self.overruns += 1
            due_s = now_s
        time.sleep(due_s - now_s)
        self._due_s = due_s + self._period_s


class StreamHealth:
    """The robot's watchdog for a display, with a longer time limit and nothing to stop.

    Its clock is the time spent waiting for the source: a slow tracker, a pause or a first
    compilation is no silence of the sensor. A fault stays until it is reset.

    Args:
        waited_s: Seconds spent waiting for the source so far.
    """

    def __init__(self, waited_s: Callable[[], float]) -> None:
        self.watchdog = Watchdog(WatchdogConfig(stale_s=STALE_S), lambda: None, waited_s)
        self.reset()

    def told(self) -> dict[str, str]:
        """Return the state for the page."""
        return {"health": self.watchdog.health.name, "reason": self.watchdog.reason}

    def delivered(self) -> None:
        """Report that the source has delivered everything that was asked of it."""
        self.watchdog.check()
        self.watchdog.beat()

    def lost(self, reason: str) -> None:
        """Report that the source has failed for good; the loss replaces an earlier fault."""
        self.watchdog.reset()
        self.watchdog.disconnected(reason)

    def reset(self) -> None:
        """Clear a fault; a source that is lost stays lost."""
        if self.watchdog.health is not Health.DISCONNECTED:
            self.watchdog.disarm()
            self.watchdog.reset()
            self.watchdog.self_test()
            self.watchdog.arm()
