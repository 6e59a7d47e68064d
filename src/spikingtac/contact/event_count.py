"""The published detector: contact where the events of 1 ms exceed a threshold (Section V-B)."""

from __future__ import annotations

from dataclasses import dataclass

from spikingtac.contact.details import ContactDetails
from spikingtac.contact.detector import DetectorSummary
from spikingtac.contact.quiet import QuietStatistics
from spikingtac.contact.window import Window, count_of, packets_of
from spikingtac.errors import ConfigError
from spikingtac.types import Contact


@dataclass(frozen=True, kw_only=True)
class EventCountConfig:
    """The published threshold test.

    The paper gives a period of 1 ms and no value of its "predefined threshold"; it is taken from
    windows of the moving arm without contact.

    Attributes:
        threshold: A contact begins where the count exceeds it.
        release_windows: A contact ends after this many windows in a row below the threshold (ours:
            a contact that slides or bounces is one contact).
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
