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
    """The published count test, with the threshold of the stream's own beginning.

    A contact begins at a count with a margin above the quiet ones, and lasts until the counts have
    been quiet themselves for a while: a slow slide stays below the margin, and is no new contact.
    """

    def __init__(self) -> None:
        self._first: list[EventPacket] = []
        self._begin: EventCountDetector | None = None
        self._last: EventCountDetector | None = None
        self._told = False

    def update(self, window: EventPacket) -> Contact | None:
        """Take the next window; return the contact that begins in it, if one does."""
        if self._begin is None or self._last is None:
            self._learn(window)
            return None
        begun = self._begin.update(window)
        self._last.update(window)
        self._told = self._told and self._last.in_contact
        if begun is None or self._told:
            return None
        self._told = True
        return begun

    def _learn(self, window: EventPacket) -> None:
        self._first.append(window)
        if len(self._first) < FIRST_WINDOWS:
            return
        quiet = QuietStatistics.of(self._first)
        low = quiet.threshold(FALSE_ALARMS_PER_HOUR)
        high = max(low, LEAST_MARGIN * quiet.mean)
        self._begin = EventCountDetector(EventCountConfig(threshold=high, release_windows=1))
        self._last = EventCountDetector(
            EventCountConfig(threshold=low, release_windows=RELEASE_WINDOWS)
        )
        self._first.clear()
