"""The project's detector: a sequential test of the markers' signed evidence for a common motion.

Arm vibration moves the markers to and fro, so its evidence cancels within a period. Noise of the
pixels cancels around each rim. A contact moves the field one way, so its evidence adds up.

A contact ends when the markers have returned to rest. Neither the absence of events ends it, since
a finger that holds still sends none, nor a motion back, since a finger may circle or twist. The
distance of the markers from rest, in any direction, decides.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import DetectorSummary, Period, Window, check_budget, packets_of
from spikingtac.contact.evidence import ScaleSums, ScaleTest, distance_of, evidence_of, rim_table
from spikingtac.contact.quiet_evidence import QuietEvidence, quiet_evidence, scale_test
from spikingtac.errors import CalibrationError
from spikingtac.types import US_PER_S, Contact, FloatArray

# Share of their largest distance from rest below which the markers have returned (16 scenes of the
# twin: up to 0.25 remains 60 ms after a contact, and 0.38 and more while a body presses).
BACK_SHARE = 0.3
NO_DISTANCE = 0.25  # Insignificant evidence for a distance, per marker (up to 4 are alike).

# Windows in a row after which a contact ends whose markers have returned. In none of them they move
# away, but they may creep on towards the rest (another simulator: of 274 contacts 30 began while
# creep kept the one before from its end, now one).
REST_WINDOWS = 50

# Windows in a row without any motion after which any may be a contact, and not only one away from
# rest: the skin creeps after a release, which the longest scale detects late (250 to 350 are
# alike). A contact whose markers have not left yet ends after as many (with 50, 4 of 6 slow presses
# on a simulated sensor of rare OFF events were told twice).
CREEP_WINDOWS = 300

# Windows without motion in which the pixels' levels are forgotten to 37 %, since leak and noise
# change them, too: of a leak of 0.1 Hz one event is left.
LEVEL_WINDOWS = 10_000


class ReleaseMonitor:
    """Tracks the distance of the markers from rest since the beginning of a contact.

    Args:
        total: ``(length,)`` evidence of the contact up to the decision.
        markers: Number of markers, over all sensors.

    Attributes:
        over: True once the markers have returned and stayed at rest.
        rest: Windows in a row at rest that end the contact; more where they have not left yet.
    """

    def __init__(self, total: FloatArray, markers: int) -> None:
        self.over, self.rest = False, CREEP_WINDOWS
        self._distance = self._farthest = distance_of(total)
        self._none = NO_DISTANCE * markers
        self._nearest, self._windows = math.inf, 0  # since the markers returned

    def add(self, evidence: FloatArray) -> bool:
        """Take the next window's evidence; return whether markers that had returned move away."""
        self._distance += distance_of(evidence)
        self._farthest = max(self._farthest, self._distance)
        return self._is_beyond(self._nearest)

    def _is_beyond(self, distance: float) -> bool:
        """Return whether the markers are clearly farther than a distance."""
        clear = self._none if self.over else max(BACK_SHARE * self._farthest, self._none)
        return self._distance > distance + clear

    def back(self) -> bool:
        """Return whether the markers have returned, or had when the contact ended."""
        nearest = 0.0 if math.isinf(self._nearest) else max(self._nearest, 0.0)
        if not self.over and self._is_beyond(nearest):
            self._nearest, self._windows, self.rest = math.inf, 0, REST_WINDOWS
            return False
        self._windows += 1
        if self._windows >= self.rest and (self.over or self._farthest > self._none):
            self._nearest = min(self._nearest, self._distance)
        return True


class SequentialMotionDetector:
    """Finds contacts by the markers' common motion; see the module.

    Args:
        learned: Evidence of the quiet windows, with rims and hot pixels.
        test: The tests with their thresholds, made from the same windows.

    Attributes:
        in_contact: True from a contact until its end.
        test: As given.
    """

    def __init__(self, learned: QuietEvidence, test: ScaleTest) -> None:
        self.test = test
        self._learned, self._sums = learned, ScaleSums(test)
        self._period = Period(round(learned.statistics.period_s * US_PER_S))
        self._markers = sum(table.markers for table in learned.tables)
        self.reset()

    @classmethod
    def from_quiet(
        cls, calibrations: Sequence[Calibration], quiet: Iterable[Window], alarms_per_hour: float
    ) -> SequentialMotionDetector:
        """Build a detector from quiet windows of the moving arm.

        Args:
            calibrations: Of each sensor, in the windows' order, as the markers rest in the grip.
            quiet: At least 0.2 s of windows; a minute is good.
            alarms_per_hour: Budget of false contacts.

        Raises:
            CalibrationError: There is no calibration, or the quiet windows are too few.
            ConfigError: The budget is not a positive number.
        """
        check_budget(alarms_per_hour)
        if not calibrations:
            raise CalibrationError(
                "the sequential motion detector uses the markers' rims and needs a calibration "
                "of each sensor; make one with: spikingtac calibrate RECORDING -o calibration.json"
            )
        learned = quiet_evidence([rim_table(calibration) for calibration in calibrations], quiet)
        return cls(learned, scale_test(learned, alarms_per_hour))

    def update(self, window: Window) -> Contact | None:
        """Return the contact that begins in a window, if one does."""
        self._period.count(window)
        evidence = evidence_of(window, self._learned.tables)
        values = self._sums.add(evidence)
        ratio = values / self.test.threshold
        scale = int(ratio.argmax())
        found = bool(ratio[scale] > 1.0)
        if self._release is None:
            self._still += 1
        else:
            found = self._is_next(self._release, evidence, scale if found else None)
        if not found:
            return None
        self._release = ReleaseMonitor(self._sums.total(scale), self._markers)
        for table in self._learned.tables:
            table.level[:] *= math.exp(-self._still / LEVEL_WINDOWS)
        self.in_contact, self._calm, self._still = True, 0, 0
        t_us = packets_of(window)[0].t_end_us
        return Contact(t_us, float(values[scale]), float(self.test.threshold[scale]))

    def summary(self) -> DetectorSummary:
        """Return hot pixels, time scales and thresholds, and the quiet windows they came from."""
        test, learned = self.test, self._learned
        return DetectorSummary(
            rule="a contact is a common motion of the markers whose squared whitened evidence "
            f"exceeds its threshold, {test.threshold.min():.0f} or more, on one of "
            f"{len(test.windows)} time scales",
            quiet=learned.statistics,
            figures={
                "hot_pixels": list(learned.hot_pixels),
                "scales_ms": [int(ms) for ms in 1e3 * learned.statistics.period_s * test.windows],
                "thresholds": [round(float(value), 3) for value in test.threshold],
            },
        )

    def reset(self) -> None:
        """Forget the past windows, but keep what was learned from the quiet ones."""
        self._release: ReleaseMonitor | None = None
        self.in_contact, self._calm, self._still = False, 0, 0
        self._sums.reset()
        for table in self._learned.tables:
            table.level[:] = 0.0

    def _is_next(self, release: ReleaseMonitor, evidence: FloatArray, found: int | None) -> bool:
        """Follow a contact to its end; return whether the next one has begun.

        Once the markers have come back, the contact ends when they rest, creep on towards the
        rest, or move away again.

        Args:
            release: Follows the markers.
            evidence: Of the next window.
            found: The scale that exceeds its threshold, None where none does.
        """
        left, back = release.add(evidence), release.back()
        # Where no scale saw them leave, they are away although the last contact has ended.
        if found is not None and (left or not (back or self.in_contact)):
            return True
        departs = found is not None and distance_of(self._sums.total(found)) > 0.0
        if back and found is not None:
            self._sums.reset()  # the same windows must not find the same motion again
        self._calm = self._calm + 1 if back and not departs else 0
        self._still = self._still + 1 if back and found is None else 0
        if self._calm >= release.rest:
            self.in_contact = False
        release.over |= self._still >= release.rest
        if self._still >= CREEP_WINDOWS:
            self._release = None
        return False
