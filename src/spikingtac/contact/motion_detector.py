"""The project's detector: a sequential test of the markers' signed votes for a common motion.

Arm vibration moves the markers to and fro, so that its votes cancel within a period; noise of the
pixels cancels around each rim; a contact moves the field one way, so that its votes add up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.contact_details import ContactDetails, gel_touch, likeliest_onset
from spikingtac.contact.detector import Window, packets_of
from spikingtac.contact.quiet_votes import LearningConfig, QuietVotes, quiet_votes, scale_test
from spikingtac.contact.release import ReleaseConfig, ReleaseWatch
from spikingtac.contact.rim_votes import RimConfig, rim_table
from spikingtac.contact.scales import ScaleSums, ScaleTest, Vector, exceeded_kernel
from spikingtac.contact.vote_counter import VoteCounter
from spikingtac.errors import CalibrationError
from spikingtac.types import Contact


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """The default detector.

    Attributes:
        rim: Which pixels count.
        learning: How its thresholds are made.
        release: When a contact has ended.
    """

    rim: RimConfig = field(default_factory=RimConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)
    release: ReleaseConfig = field(default_factory=ReleaseConfig)


class MotionDetector:
    """Tells contact by the markers' common motion; see the module.

    Args:
        config: How contacts end; the rest was used in learning.
        learned: What the quiet windows taught: rims and hot pixels.
        test: The same: the tests with their thresholds.

    Attributes:
        in_contact: True from a contact until its end.
        hot_pixels: How many pixels of each sensor's rims have no say.
        test: As given.
    """

    def __init__(self, config: MotionConfig, learned: QuietVotes, test: ScaleTest) -> None:
        self.in_contact = False
        self.hot_pixels, self.test = learned.hot_pixels, test
        self._config = config
        self._period_us = round(learned.period_s * 1e6)
        self._noise = [learned.marker_noise(sensor) for sensor in range(len(learned.tables))]
        self._votes = VoteCounter(learned.tables, int(test.windows[-1]))
        self._sums = ScaleSums(test)
        self._release: ReleaseWatch | None = None
        self._begun: tuple[int, Vector] | None = None
        self._along = test.mean
        self._calm: int | None = None
        self._end_us = 0
        exceeded_kernel(np.zeros(len(test.threshold)), test.threshold)  # compiled now, not later

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
            CalibrationError: There is no calibration, or the quiet windows are too few.
        """
        if not calibrations:
            raise CalibrationError(
                "the default contact detector looks at the markers' rims and needs a calibration "
                "of each sensor; make one with: spikingtac calibrate RECORDING -o calibration.json"
            )
        tables = [rim_table(calibration, config.rim) for calibration in calibrations]
        learned = quiet_votes(tables, quiet, config.learning)
        return cls(config, learned, scale_test(learned, config.learning, alarms_per_hour))

    def update(self, window: Window) -> Contact | None:
        """Return the contact that begins in a window, if one does."""
        self._open()
        votes = self._votes.count(window)
        values = self._sums.add(votes)
        self._end_us = packets_of(window)[0].t_end_us
        scale = exceeded_kernel(values, self.test.threshold)
        if self._release is not None:
            scale = self._follow(self._release, votes, scale)
        return None if scale < 0 else self._begin(scale, values)

    def details(self) -> ContactDetails:
        """Return what is known about the present contact; more, the later it is asked.

        It looks back over the longest scale, 0.26 s. Ask after the stop was sent.

        Raises:
            ValueError: There is no contact now.
        """
        self._open()
        if self._release is None:
            raise ValueError("there is no contact to describe; ask while in_contact is True")
        course = self._sums.course(self._along)
        windows = len(course) - 1 - likeliest_onset(course)
        recent = self._votes.recent(windows)
        touches = tuple(
            gel_touch(votes, table.center_px, windows * noise)
            for votes, table, noise in zip(recent, self._votes.tables, self._noise, strict=True)
        )
        return ContactDetails(self._end_us - windows * self._period_us, touches)

    def reset(self) -> None:
        """Forget the past windows, not the calibration."""
        self.in_contact = False
        self._release, self._calm, self._begun = None, None, None
        self._votes.reset()
        self._sums.reset()

    def _begin(self, scale: int, values: Vector) -> Contact:
        self._begun = scale, self._sums.total(scale)
        self.in_contact, self._calm = True, None
        return Contact(self._end_us, float(values[scale]), float(self.test.threshold[scale]))

    def _open(self) -> None:
        """Begin to follow a contact: put off until the stop was sent, since it takes a while."""
        if self._begun is None:
            return
        (scale, total), self._begun = self._begun, None
        markers = sum(len(table.center_px) for table in self._votes.tables)
        self._release = ReleaseWatch(self._config.release, self.test.mean, total, markers)
        self._along = self.test.whiten[scale].T @ (self.test.whiten[scale] @ total)

    def _follow(self, release: ReleaseWatch, votes: Vector, scale: int) -> int:
        """Go on with a contact; return the scale that found the next one, or -1.

        Once the markers have come back, the contact ends when they rest, or when they leave again.
        """
        release.add(votes)
        back = scale >= 0 and release.motion(self._sums.total(scale))
        if self._calm is None:
            if release.left():
                self._calm = 0
                self._sums.reset()
            return -1
        if scale >= 0 and not back:
            return scale
        self._calm = 0 if back else self._calm + 1
        if back:
            self._sums.reset()  # the same windows must not find the same motion again
        if self._calm >= self._config.release.rest_windows:
            self._release, self._calm, self.in_contact = None, None, False
        return -1
