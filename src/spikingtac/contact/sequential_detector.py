"""The project's detector: a sequential test of the markers' signed evidence for a common motion.

Arm vibration moves the markers to and fro, so its evidence cancels within a period. Noise of the
pixels cancels around each rim. A contact moves the field one way, so its evidence adds up.

A contact ends when the markers have come back. Silence is no sign of an end: a finger that holds
still is as silent as one that let go.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import DetectorSummary, Window, check_budget, packets_of
from spikingtac.contact.evidence import (
    AFFINE_MODES,
    POLARITIES,
    ScaleSums,
    ScaleTest,
    Vector,
    evidence_of,
    rim_table,
)
from spikingtac.contact.quiet_evidence import QuietEvidence, quiet_evidence, scale_test
from spikingtac.errors import CalibrationError
from spikingtac.types import Contact

# The contact ends once the markers have come back by this share of their largest displacement,
# less the dead travel (light presses of the twin come back by no more).
BACK_SHARE = 0.4

# OFF evidence per marker that is lost at a reversal, since each pixel has to come back by up to two
# thresholds before it fires (measured on the twin: light presses).
DEAD_EVIDENCE = 4.0
REST_WINDOWS = 50  # Windows in a row without motion after which a contact ends, markers back.


class ReleaseMonitor:
    """Follows the markers' common motion since a contact began, until they are back.

    It uses OFF evidence only: the leak adds to the ON evidence for as long as a contact lasts.

    Args:
        mean: ``(length,)`` evidence per window without contact.
        total: ``(length,)`` evidence of the contact up to the decision.
        markers: How many markers there are, over all sensors.
    """

    def __init__(self, mean: Vector, total: Vector, markers: int) -> None:
        self._mean = _off(mean)
        self._moved = _off(total)
        self._farthest = self._moved.copy()
        self._length = float(np.linalg.norm(self._farthest))
        self._dead = DEAD_EVIDENCE * markers
        self._returning = False

    def add(self, evidence: Vector) -> None:
        """Take the evidence of the next window."""
        self._moved += _off(evidence) - self._mean
        length = float(np.linalg.norm(self._moved))
        if length > self._length:
            self._farthest, self._length = self._moved.copy(), length

    def motion(self, total: Vector) -> bool:
        """Take the evidence of a scale that found a new motion; return True for a motion back."""
        self._returning = float(_off(total) @ self._farthest) < 0.0
        return self._returning

    def left(self) -> bool:
        """Return True once a motion back was found and has led far enough."""
        if not self._returning:
            return False
        back = float((self._farthest - self._moved) @ self._farthest) / self._length
        return back >= BACK_SHARE * (self._length - self._dead)


def _off(evidence: Vector) -> Vector:
    return evidence.reshape(-1, POLARITIES, AFFINE_MODES)[:, 0].ravel().copy()


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
        self.in_contact, self.test = False, test
        self._learned, self._sums = learned, ScaleSums(test)
        self._markers = sum(table.markers for table in learned.tables)
        self._release: ReleaseMonitor | None = None
        self._calm: int | None = None

    @classmethod
    def from_quiet(
        cls,
        calibrations: Sequence[Calibration],
        quiet: Iterable[Window],
        alarms_per_hour: float,
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
        evidence = evidence_of(window, self._learned.tables)
        values = self._sums.add(evidence)
        ratio = values / self.test.threshold
        scale = int(ratio.argmax())
        found = bool(ratio[scale] > 1.0)
        if self._release is not None:
            found = self._is_next(self._release, evidence, scale if found else None)
        if not found:
            return None
        total = self._sums.total(scale)
        self._release = ReleaseMonitor(self.test.mean, total, self._markers)
        self.in_contact, self._calm = True, None
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
                "scales_ms": [int(count * learned.period_s * 1e3) for count in test.windows],
                "thresholds": [round(float(value), 3) for value in test.threshold],
            },
        )

    def reset(self) -> None:
        """Forget the past windows, but keep what was learned from the quiet ones."""
        self.in_contact, self._release, self._calm = False, None, None
        self._sums.reset()

    def _is_next(self, release: ReleaseMonitor, evidence: Vector, scale: int | None) -> bool:
        """Follow a contact to its end; return whether the next one has begun.

        Once the markers have come back, the contact ends when they rest or move away again.

        Args:
            release: Follows the markers.
            evidence: Of the window.
            scale: Which one exceeds its threshold.
        """
        release.add(evidence)
        back = scale is not None and release.motion(self._sums.total(scale))
        if self._calm is None:
            if release.left():
                self._calm = 0
                self._sums.reset()
            return False
        if scale is not None and not back:
            return True
        self._calm = 0 if back else self._calm + 1
        if back:
            self._sums.reset()  # the same windows must not find the same motion again
        if self._calm >= REST_WINDOWS:
            self._release, self._calm, self.in_contact = None, None, False
        return False
