"""A limit of force, where a contact detector is asked for: an arm's guard stops at it."""

from __future__ import annotations

from spikingtac.contact.detector import DetectorSummary, Window, packets_of
from spikingtac.errors import ConfigError
from spikingtac.markers.registry import MarkerTracker
from spikingtac.touch.force.model import ForceEstimator
from spikingtac.types import Contact


class ForceLimit:
    """Decides where the force on one sensor surely exceeds a limit: less its 90 % interval.

    It tracks the markers in every window, which costs more than to count events.

    Attributes:
        in_contact: True while the force exceeds the limit.
    """

    def __init__(self, tracker: MarkerTracker, estimator: ForceEstimator, limit_n: float) -> None:
        """Begin at the calibrated rest.

        Raises:
            ConfigError: The limit is not positive.
        """
        if not limit_n > 0.0:
            raise ConfigError(f"the limit of force is {limit_n:g} N, it must be positive")
        self._tracker, self._estimator, self._limit_n = tracker, estimator, limit_n
        self.in_contact = False

    def update(self, window: Window) -> Contact | None:
        """Follow the markers through the next window; return a contact where the force is large."""
        (packet,) = packets_of(window)
        self._tracker.absorb(packet)
        frame = self._tracker.estimate(packet.t_end_us)
        wrench = self._estimator.update(frame.t_us, frame.displacement_px)
        before, self.in_contact = self.in_contact, wrench.exceeds(self._limit_n)
        begins = self.in_contact and not before
        return Contact(frame.t_us, wrench.least_n, self._limit_n) if begins else None

    def reset(self) -> None:
        """Forget the past windows."""
        self._tracker.reset()
        self._estimator.reset()
        self.in_contact = False

    def summary(self) -> DetectorSummary:
        """Return the rule."""
        return DetectorSummary(rule=f"force, less its 90 % interval, above {self._limit_n:g} N")
