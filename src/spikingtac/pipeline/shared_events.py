"""A tracker whose events somebody else takes in too, cut at the same times."""

from __future__ import annotations

from collections.abc import Callable

from spikingtac.markers.tracker import MarkerTracker
from spikingtac.types import EventPacket, MarkerFrame


class SharedEventsTracker:
    """Passes every packet to a listener before the tracker takes it in.

    What listens to the source instead is ahead of the frames by the rest of a packet, and its
    results depend on how the stream was cut.
    """

    def __init__(self, tracker: MarkerTracker, listener: Callable[[EventPacket], None]) -> None:
        self._tracker, self._listener = tracker, listener

    def absorb(self, packet: EventPacket) -> None:
        """Give the events to the listener and to the tracker."""
        self._listener(packet)
        self._tracker.absorb(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the tracker's estimate."""
        return self._tracker.estimate(t_us)

    def reset(self) -> None:
        """Reset the tracker."""
        self._tracker.reset()
