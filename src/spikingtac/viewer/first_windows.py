"""A contact detector for what nobody calibrated: it learns its threshold from the first windows.

It serves the display. A robot is stopped by a detector whose threshold was taken from a recording
of the moving arm (``spikingtac.contact``).
"""

from __future__ import annotations

from spikingtac.contact.event_count import EventCountConfig, EventCountDetector
from spikingtac.contact.quiet import QuietStatistics
from spikingtac.types import Contact, EventPacket

FIRST_WINDOWS = 300
"""Windows that are taken for quiet: 0.3 s, which every recording of ours begins with."""
FALSE_ALARMS_PER_HOUR = 1.0
RELEASE_WINDOWS = 300
"""A finger that holds still is as silent as one that left; 0.3 s of it do not end a contact."""
LEAST_MARGIN = 3.0
"""The threshold is at least so many times the quiet mean: the first windows may be the calmest."""


class FirstWindowsWatch:
    """The published count test, with the threshold of the stream's own beginning."""

    def __init__(self) -> None:
        self._first: list[EventPacket] = []
        self._detector: EventCountDetector | None = None

    def update(self, window: EventPacket) -> Contact | None:
        """Take the next window; return the contact that begins in it, if one does."""
        if self._detector is not None:
            return self._detector.update(window)
        self._first.append(window)
        if len(self._first) == FIRST_WINDOWS:
            quiet = QuietStatistics.of(self._first)
            threshold = max(quiet.threshold(FALSE_ALARMS_PER_HOUR), LEAST_MARGIN * quiet.mean)
            self._detector = EventCountDetector(
                EventCountConfig(threshold=threshold, release_windows=RELEASE_WINDOWS)
            )
            self._first.clear()
        return None
