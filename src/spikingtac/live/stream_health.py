"""Whether a live source still delivers: the robot's watchdog, with the patience of a display.

Its clock is the time spent waiting for the source. So a tracker that is slow, a pause or a first
compilation is no silence of the sensor, and silence is no fault as long as the source answers with
empty packets. A fault stays until it is reset, so that one that has passed is still seen.
"""

from __future__ import annotations

from collections.abc import Callable

from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig

STALE_S = 0.5
"""Waiting for so long is seen as a standstill; an arm is given ten milliseconds (ours)."""


class StreamHealth:
    """Follows one live source; it stops nothing, since a display has nothing to stop."""

    def __init__(self, waited_s: Callable[[], float]) -> None:
        """Begin to watch.

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

    def answered(self) -> None:
        """Say that the source has given everything that was asked of it."""
        self._watchdog.check()
        self._watchdog.beat()

    def lost(self, reason: str) -> None:
        """Say that the source has failed for good."""
        self._watchdog.reset()  # an earlier fault has lost its interest
        self._watchdog.disconnected(reason)

    def reset(self) -> None:
        """Forget a fault that was seen; a source that is lost stays lost."""
        if self.health is Health.DISCONNECTED:
            return
        self._watchdog.disarm()
        self._watchdog.reset()
        self._watchdog.self_test()
        self._watchdog.arm()


def _stop_nothing() -> None:
    """Do nothing."""
