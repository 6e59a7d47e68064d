"""The protocol of every marker tracker.

It is split in two because the paper has two rates: perception sees every event, estimates are
asked for at their own times.
"""

from __future__ import annotations

from typing import Protocol

from spikingtac.types import EventPacket, MarkerFrame


class MarkerTracker(Protocol):
    """Follows the markers of one sensor; free of input and output."""

    def absorb(self, packet: EventPacket) -> None:
        """Take in every event of the next stretch of time (cost grows with the events).

        Any cutting of the same events into packets leads to the same state.
        """
        ...

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the markers at ``t_us``, the end of what was absorbed."""
        ...

    def reset(self) -> None:
        """Forget everything but the calibration."""
        ...
