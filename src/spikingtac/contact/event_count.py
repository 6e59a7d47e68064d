"""The published detector: contact where the events of 1 ms exceed a threshold (Section V-B).

:class:`SelfCalibratingDetector` learns the threshold from the first windows of a recording. It
serves displays. A robot is stopped by a detector whose threshold comes from a recording of the
moving arm (:func:`spikingtac.contact.registry.make_detector`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spikingtac.contact.detector import (
    ContactDetails,
    DetectorSummary,
    QuietStatistics,
    Window,
    count_of,
    packets_of,
    unsettled,
)
from spikingtac.errors import ConfigError
from spikingtac.types import Contact


@dataclass(frozen=True, kw_only=True)
class EventCountConfig:
    """The published threshold test.

    The paper gives a period of 1 ms and no value of its "predefined threshold"; it is taken from
    windows of the moving arm without contact.

    Attributes:
        threshold: A contact begins where the count exceeds it.
        release_windows: A contact ends after this many windows in a row below the threshold
            (a contact that slides or bounces is one contact).
    """

    threshold: float
    release_windows: int = 50

    def __post_init__(self) -> None:
        if not self.threshold >= 0 or self.release_windows < 1:
            raise ConfigError("threshold must not be negative and release_windows be at least 1")

    @classmethod
    def from_quiet(
        cls, quiet: QuietStatistics, false_alarms_per_hour: float = 1.0
    ) -> EventCountConfig:
        """Return the configuration that keeps a false-alarm budget on the quiet windows."""
        return cls(threshold=quiet.threshold(false_alarms_per_hour))


class EventCountDetector:
    """Counts raw events per window; see :class:`~spikingtac.contact.detector.ContactDetector`.

    Args:
        config: Threshold and release.
        quiet: The windows that the threshold was taken from, for the summary.

    Attributes:
        in_contact: True from a contact until enough quiet windows have passed.
    """

    def __init__(self, config: EventCountConfig, quiet: QuietStatistics | None = None) -> None:
        self.in_contact = False
        self._config, self._statistics = config, quiet
        self._quiet = 0

    @property
    def threshold(self) -> float:
        """A contact begins where the count exceeds this."""
        return self._config.threshold

    def update(self, window: Window) -> Contact | None:
        """Return a contact where the count exceeds the threshold for the first time."""
        count, threshold = count_of(window), self._config.threshold
        if count <= threshold:
            self._quiet += 1
            self.in_contact = self.in_contact and self._quiet < self._config.release_windows
            return None
        self._quiet = 0
        if self.in_contact:
            return None
        self.in_contact = True
        return Contact(t_us=packets_of(window)[0].t_end_us, count=float(count), threshold=threshold)

    def reset(self) -> None:
        """Forget that there was a contact."""
        self.in_contact, self._quiet = False, 0

    def details(self) -> ContactDetails | None:
        """Return None: a count gives neither onset nor place."""
        return None

    def summary(self) -> DetectorSummary:
        """Return the threshold and the quiet windows that it was taken from."""
        return DetectorSummary(
            rule=f"a contact is more than {self.threshold:g} events in a window",
            quiet=self._statistics,
            figures={"threshold": self.threshold},
        )


# The first windows, which are taken for quiet: 0.3 s, as every scene of the twin begins.
QUIET_WINDOWS = 300

# The threshold is at least this many times the quiet mean (the first windows may be the
# calmest of all).
MARGIN = 3.0

# A contact ends after this many quiet windows in a row (a finger that holds still is as
# silent as one that left).
RELEASE_WINDOWS = 300


class SelfCalibratingDetector:
    """The published count test with the threshold of the stream's own beginning.

    A contact begins at a count above the quiet ones by a margin. It lasts until the counts have
    been quiet themselves for a while: a slow slide stays below the margin and is no new contact.

    Args:
        false_alarms_per_hour: Budget of false contacts.

    Attributes:
        in_contact: True from a contact until its end.
    """

    def __init__(self, false_alarms_per_hour: float = 1.0) -> None:
        self.in_contact = False
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
            left = QUIET_WINDOWS - len(self._first)
            return DetectorSummary(rule=f"the threshold is learned from the next {left} windows")
        return self._begin.summary()

    def _learn(self, window: Window) -> None:
        self._first.append(window)
        if len(self._first) < QUIET_WINDOWS:
            return
        del self._first[: unsettled(np.array([count_of(one) for one in self._first]))]
        if len(self._first) < QUIET_WINDOWS:
            return
        quiet = QuietStatistics.of(self._first)
        low = quiet.threshold(self._budget)
        high = max(low, MARGIN * quiet.mean)
        self._begin = EventCountDetector(EventCountConfig(threshold=high, release_windows=1), quiet)
        self._end = EventCountDetector(
            EventCountConfig(threshold=low, release_windows=RELEASE_WINDOWS)
        )
        self._first.clear()
