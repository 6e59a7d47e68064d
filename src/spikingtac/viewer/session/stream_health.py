"""Health of a live source in the viewer: the robot's watchdog with a longer time limit.

Its clock is the time spent waiting for the source. A slow tracker, a pause or a first compilation
is therefore no silence of the sensor, and silence is no fault while the source delivers empty
packets. A fault stays until it is reset, so that a past one is still visible.
"""

from __future__ import annotations

from collections.abc import Callable

from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig

STALE_S = 0.5
"""Waiting this long counts as a standstill, s; an arm is stopped after 40 ms (ours)."""


class StreamHealth:
    """Monitors one live source; it stops nothing, since a display has nothing to stop."""

    def __init__(self, waited_s: Callable[[], float]) -> None:
        """Begin to monitor.

        Args:
            waited_s: Seconds spent waiting for the source so far.
        """
        self._watchdog = Watchdog(WatchdogConfig(stale_s=STALE_S), _stop_nothing, waited_s)
        self.reset()

    @property
    def health(self) -> Health:
        """OK, or the first fault since the last reset."""
        return self._watchdog.health

    @property
    def reason(self) -> str:
        """The fault in words, or an empty string."""
        return self._watchdog.reason

    def delivered(self) -> None:
        """Report that the source has delivered everything that was asked of it."""
        self._watchdog.check()
        self._watchdog.beat()

    def lost(self, reason: str) -> None:
        """Report that the source has failed for good."""
        self._watchdog.reset()  # the loss replaces an earlier fault
        self._watchdog.disconnected(reason)

    def reset(self) -> None:
        """Clear a fault; a source that is lost stays lost."""
        if self.health is Health.DISCONNECTED:
            return
        self._watchdog.disarm()
        self._watchdog.reset()
        self._watchdog.self_test()
        self._watchdog.arm()


def _stop_nothing() -> None:
    """Do nothing."""
