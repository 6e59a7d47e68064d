"""The contact detectors by name, each built from quiet windows of the moving arm.

The published detector finds a contact where the events of 1 ms exceed a threshold (Section V-B).
:class:`SelfCalibratingDetector` learns that threshold from the first windows of a stream. It serves
displays; a robot is stopped by a detector that has learned from the moving arm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spikingtac import plugins
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import (
    ContactDetector,
    DetectorSummary,
    Period,
    QuietStatistics,
    Window,
    check_budget,
    count_of,
    packets_of,
    unsettled,
)
from spikingtac.contact.sequential_detector import SequentialMotionDetector
from spikingtac.errors import ConfigError, named, require_type
from spikingtac.events.source import refuse_path
from spikingtac.types import US_PER_S, Contact

# First windows of a stream, which are taken for quiet: 0.3 s, as every scene of the twin begins.
QUIET_WINDOWS = 300

# Least ratio of such a threshold to the quiet mean (the first windows may be the calmest).
MARGIN = 3.0

# Quiet windows in a row that end a contact then (a finger that holds still is as silent as one
# that left).
RELEASE_WINDOWS = 300


class EventCountDetector:
    """The published threshold test on raw events per window.

    See :class:`~spikingtac.contact.detector.ContactDetector`. The paper gives a period of 1 ms and
    no value of its "predefined threshold"; it is taken from windows of the moving arm without
    contact.

    Args:
        threshold: A contact begins where the count exceeds it.
        release_windows: A contact ends after this many windows in a row below the threshold
            (a contact that slides or bounces is one contact).
        quiet: The windows that the threshold was taken from, for the summary.
        least: A contact lasts while counts exceed this; the threshold unless given.

    Attributes:
        in_contact: True from a contact until enough quiet windows have passed.
    """

    def __init__(
        self,
        threshold: float,
        release_windows: int = 50,
        quiet: QuietStatistics | None = None,
        least: float | None = None,
    ) -> None:
        if not threshold >= 0 or release_windows < 1:
            raise ConfigError("threshold must not be negative and release_windows be at least 1")
        self.in_contact, self.threshold = False, threshold
        self._release_windows, self._statistics = release_windows, quiet
        self._least = threshold if least is None else least
        self._quiet = 0
        self._period = Period(0 if quiet is None else round(quiet.period_s * US_PER_S))

    @classmethod
    def from_quiet(
        cls, quiet: QuietStatistics, false_alarms_per_hour: float = 1.0
    ) -> EventCountDetector:
        """Return the detector that keeps a budget of false contacts on the quiet windows."""
        return cls(quiet.threshold(false_alarms_per_hour), quiet=quiet)

    def update(self, window: Window) -> Contact | None:
        """Return a contact where the count exceeds the threshold for the first time."""
        count, threshold = self._period.count(window), self.threshold
        self._quiet = 0 if count > self._least else self._quiet + 1
        self.in_contact = self.in_contact and self._quiet < self._release_windows
        if self.in_contact or count <= threshold:
            return None
        self.in_contact = True
        return Contact(t_us=packets_of(window)[0].t_end_us, count=float(count), threshold=threshold)

    def reset(self) -> None:
        """Forget that there was a contact."""
        self.in_contact, self._quiet = False, 0

    def summary(self) -> DetectorSummary:
        """Return the threshold and the quiet windows that it was taken from."""
        return DetectorSummary(
            rule=f"a contact is more than {self.threshold:g} events in a window",
            quiet=self._statistics,
            figures={"threshold": self.threshold},
        )


class SelfCalibratingDetector:
    """The published count test with the threshold of the stream's own beginning.

    A contact begins at a count above the quiet ones by a margin. It lasts until the counts have
    been quiet themselves for a while: a slow slide stays below the margin and is no new contact.

    Args:
        false_alarms_per_hour: Budget of false contacts.
    """

    def __init__(self, false_alarms_per_hour: float = 1.0) -> None:
        self._budget = false_alarms_per_hour
        self._first: list[Window] = []
        self._learned: EventCountDetector | None = None

    @property
    def in_contact(self) -> bool:
        """True from a contact until its end."""
        return self._learned is not None and self._learned.in_contact

    def update(self, window: Window) -> Contact | None:
        """Take the next window; return the contact that begins in it, if one does."""
        if self._learned is not None:
            return self._learned.update(window)
        first = self._first
        first.append(window)
        if len(first) >= QUIET_WINDOWS:
            del first[: unsettled(np.array([count_of(one) for one in first]))]
        if len(first) >= QUIET_WINDOWS:
            quiet = QuietStatistics.of(first)
            low = quiet.threshold(self._budget)
            high = max(low, MARGIN * quiet.mean)
            self._learned = EventCountDetector(high, RELEASE_WINDOWS, quiet, low)
        return None

    def reset(self) -> None:
        """Forget the past windows, but keep the learned thresholds."""
        self._first.clear()
        if self._learned is not None:
            self._learned.reset()

    def summary(self) -> DetectorSummary:
        """Return the learned threshold, or how long the detector still learns."""
        if self._learned is not None:
            return self._learned.summary()
        left = QUIET_WINDOWS - len(self._first)
        return DetectorSummary(rule=f"the threshold is learned from the next {left} windows")


@dataclass(frozen=True, kw_only=True)
class DetectionConfig:
    """How contacts are detected.

    Attributes:
        detector: Name of the detector; None is ``default`` where the sensors are calibrated and
            ``event_count`` otherwise.
        false_alarms_per_hour: Budget of false contacts while the arm moves freely.
    """

    detector: str | None = None
    false_alarms_per_hour: float = 1.0

    def __post_init__(self) -> None:
        check_budget(self.false_alarms_per_hour)


# Builds a detector from settings, the sensors' calibrations, and quiet windows.
DetectorBuilder = Callable[
    [DetectionConfig, Sequence[Calibration], Iterable[Window]], ContactDetector
]


# Name -> builder of the detectors of this package, as reports name them.
DETECTORS: dict[str, DetectorBuilder] = {
    "event_count": lambda config, _, quiet: EventCountDetector.from_quiet(
        QuietStatistics.of(quiet), config.false_alarms_per_hour
    ),
    "default": lambda config, calibrations, quiet: SequentialMotionDetector.from_quiet(
        calibrations, quiet, config.false_alarms_per_hour
    ),
}


def detectors() -> Mapping[str, DetectorBuilder]:
    """Return every detector by name, also those that other packages register."""
    return plugins.WithPlugins(DETECTORS, plugins.DETECTORS)


def make_detector(
    name: str, config: DetectionConfig, calibrations: Sequence[Calibration], quiet: Iterable[Window]
) -> ContactDetector:
    """Build a detector by name.

    Args:
        name: ``event_count`` (as published), ``default``, or the name of an entry point of the
            group ``spikingtac.contact_detectors``.
        config: Budget and settings.
        calibrations: Of each sensor, in the windows' order, with the probe in the grip.
        quiet: Windows of the moving arm without contact, in order; see each detector for how many.

    Raises:
        ConfigError: The name is unknown, or the detector's package cannot be loaded.
        CalibrationError: The quiet windows are too few, or a calibration is missing.
    """
    require_type(config, DetectionConfig, "load_config('default').contact")
    require_type(calibrations, Sequence, "Calibration.load('a.json'), in a list")
    refuse_path(quiet)
    return named(detectors(), name, "contact detector")(config, calibrations, quiet)
