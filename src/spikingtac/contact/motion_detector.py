"""The project's detector: a sequential test of the markers' signed votes for a common motion.

Arm vibration moves the markers to and fro, so that its votes cancel within a period; noise of the
pixels cancels around each rim; a contact moves the field one way, so that its votes add up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from spikingtac.contact.detect import Window, packets_of
from spikingtac.contact.learn import LearningConfig, quiet_votes, scale_test
from spikingtac.contact.rim import RimConfig, RimTable, rim_table
from spikingtac.contact.scales import ScaleSums, ScaleTest
from spikingtac.contact.votes import VoteCounter
from spikingtac.types import Calibration, Contact


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """The default detector.

    Attributes:
        rim: Which pixels count.
        learning: How its thresholds are made.
    """

    rim: RimConfig = field(default_factory=RimConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)


class MotionDetector:
    """Tells contact by the markers' common motion; see the module.

    Args:
        tables: The rims of each sensor, in the windows' order.
        test: What the quiet windows taught.
    """

    def __init__(self, tables: Sequence[RimTable], test: ScaleTest) -> None:
        self.in_contact = False
        self._test = test
        self._votes = VoteCounter(tables, int(test.windows[-1]))
        self._sums = ScaleSums(test)

    @classmethod
    def from_quiet(
        cls,
        config: MotionConfig,
        calibrations: Sequence[Calibration],
        quiet: Iterable[Window],
        alarms_per_hour: float,
    ) -> MotionDetector:
        """Build a detector from quiet windows of the moving arm.

        Args:
            config: Its settings.
            calibrations: Of each sensor, in the windows' order, as the markers rest in the grip.
            quiet: At least 2 s of windows; a minute is good.
            alarms_per_hour: Budget of false contacts.

        Raises:
            CalibrationError: The quiet windows are too few.
        """
        tables = [rim_table(calibration, config.rim) for calibration in calibrations]
        learned = quiet_votes(tables, quiet, config.learning)
        return cls(learned.tables, scale_test(learned, config.learning, alarms_per_hour))

    def update(self, window: Window) -> Contact | None:
        """Return the contact that begins in a window, if one does."""
        values = self._sums.add(self._votes.count(window))
        excess = values / self._test.threshold
        scale = int(excess.argmax())
        if excess[scale] <= 1.0 or self.in_contact:
            return None
        self.in_contact = True
        t_us = packets_of(window)[0].t_end_us
        return Contact(t_us, float(values[scale]), float(self._test.threshold[scale]))

    def reset(self) -> None:
        """Forget the past windows, not the calibration."""
        self.in_contact = False
        self._votes.reset()
        self._sums.reset()
