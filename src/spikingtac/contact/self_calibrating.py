"""A detector for recordings without a quiet stretch of their own: it learns from the first windows.

It serves displays. A robot is stopped by a detector whose threshold was taken from a recording of
the moving arm (:func:`spikingtac.contact.registry.make_detector`).
"""

from __future__ import annotations

from dataclasses import dataclass

from spikingtac.contact.details import ContactDetails
from spikingtac.contact.detector import DetectorSummary
from spikingtac.contact.event_count import EventCountConfig, EventCountDetector
from spikingtac.contact.quiet import LEAST_WINDOWS, QuietStatistics
from spikingtac.contact.window import Window
from spikingtac.errors import ConfigError
from spikingtac.types import Contact


@dataclass(frozen=True, kw_only=True)
class SelfCalibratingConfig:
    """How a detector learns its threshold from the stream that it watches.

    Attributes:
        quiet_windows: The first windows, which are taken for quiet (0.3 s: every scene of the twin
            begins with as much).
        margin: The threshold is at least this many times the quiet mean (ours: the first windows
            may be the calmest of all).
        release_windows: A contact ends after this many quiet windows in a row (ours: 0.3 s; a
            finger that holds still is as silent as one that left).
    """

    quiet_windows: int = 300
    margin: float = 3.0
    release_windows: int = 300

    def __post_init__(self) -> None:
        if self.quiet_windows < LEAST_WINDOWS or self.release_windows < 1 or not self.margin >= 1.0:
            raise ConfigError(
                f"quiet_windows must be at least {LEAST_WINDOWS}, release_windows and margin "
                "at least 1"
            )


class SelfCalibratingDetector:
    """The published count test with the threshold of the stream's own beginning.

    A contact begins at a count above the quiet ones by a margin. It lasts until the counts have
    been quiet themselves for a while: a slow slide stays below the margin and is no new contact.

    Args:
        config: How it learns.
        false_alarms_per_hour: Budget of false contacts.

    Attributes:
        in_contact: True from a contact until its end.
    """

    def __init__(
        self, config: SelfCalibratingConfig | None = None, false_alarms_per_hour: float = 1.0
    ) -> None:
        self.in_contact = False
        self._config = config or SelfCalibratingConfig()
        self._budget = false_alarms_per_hour
        self._first: list[Window] = []
        self._begin: EventCountDetector | None = None
        self._end: EventCountDetector | None = None

    def update(self, window: Window) -> Contact | None:
        """Take the next window; return the contact that begins in it, if one does."""
        if self._begin is None or self._end is None:
            self._learn(window)
            return None
        begun = self._begin.update(window)
        self._end.update(window)
        self.in_contact = self.in_contact and self._end.in_contact
        if begun is None or self.in_contact:
            return None
        self.in_contact = True
        return begun

    def reset(self) -> None:
        """Forget the past windows, but keep the learned thresholds."""
        self.in_contact = False
        self._first.clear()
        for detector in (self._begin, self._end):
            if detector is not None:
                detector.reset()

    def details(self) -> ContactDetails | None:
        """Return None: a count gives neither onset nor place."""
        return None

    def summary(self) -> DetectorSummary:
        """Return the learned threshold, or how long the detector still learns."""
        if self._begin is None:
            left = self._config.quiet_windows - len(self._first)
            return DetectorSummary(rule=f"the threshold is learned from the next {left} windows")
        return self._begin.summary()

    def _learn(self, window: Window) -> None:
        self._first.append(window)
        if len(self._first) < self._config.quiet_windows:
            return
        quiet = QuietStatistics.of(self._first)
        low = quiet.threshold(self._budget)
        high = max(low, self._config.margin * quiet.mean)
        self._begin = EventCountDetector(EventCountConfig(threshold=high, release_windows=1), quiet)
        self._end = EventCountDetector(
            EventCountConfig(threshold=low, release_windows=self._config.release_windows)
        )
        self._first.clear()
