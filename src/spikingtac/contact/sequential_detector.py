"""The project's detector: a sequential test of the markers' signed evidence for a common motion.

Arm vibration moves the markers to and fro, so its evidence cancels within a period. Noise of the
pixels cancels around each rim. A contact moves the field one way, so its evidence adds up.

A contact ends when the markers have come back. Silence is no sign of an end: a finger that holds
still is as silent as one that let go.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import (
    ContactDetails,
    DetectorSummary,
    GelTouch,
    Window,
    WindowCounter,
    check_budget,
    packets_of,
)
from spikingtac.contact.evidence import (
    AFFINE_MODES,
    POLARITIES,
    EvidenceSums,
    ScaleSums,
    ScaleTest,
    Vector,
    exceeded_kernel,
    rim_table,
)
from spikingtac.contact.quiet_evidence import (
    QuietEvidence,
    quiet_evidence,
    scale_test,
)
from spikingtac.errors import CalibrationError
from spikingtac.types import Contact

# The contact ends once the markers have come back by this share of their largest displacement,
# less the dead travel (light presses of the twin come back by no more).
BACK_SHARE = 0.4


# OFF evidence per marker that is lost at a reversal, since each pixel has to come back by up to two
# thresholds before it fires (measured on the twin: light presses).
DEAD_EVIDENCE = 4.0
REST_WINDOWS = 50  # Windows in a row without motion after which a contact ends, markers back.


# A marker counts as moved where its squared evidence exceeds that of noise by this factor. Under
# noise alone the ratio is exponentially distributed: 1 in 150 by chance.
MOVED_RATIO = 5.0


def gel_touch(evidence: Vector, center_px: Vector, noise: float) -> GelTouch | None:
    """Return place and direction from the markers' evidence, or None where no marker moved.

    Args:
        evidence: ``(m, 2)`` sum of each marker's evidence since the onset.
        center_px: ``(m, 2)`` centres of the markers, px.
        noise: Expected squared length of a marker's evidence without contact.
    """
    power = (evidence**2).sum(axis=1)
    weight = np.maximum(power - MOVED_RATIO * noise, 0.0)
    moved = weight > 0.0
    if not moved.any():
        return None
    weight = weight / weight.sum()
    place = weight @ center_px
    unit = evidence / np.sqrt(np.maximum(power, np.finfo(float).tiny))[:, None]
    away = center_px - place
    arm = weight @ np.hypot(away[:, 0], away[:, 1])
    moment = weight @ (away[:, 0] * unit[:, 1] - away[:, 1] * unit[:, 0])
    push = weight @ unit
    return GelTouch(
        place_px=(float(place[0]), float(place[1])),
        push=(float(push[0]), float(push[1])),
        turn=float(moment / arm) if arm > 0.0 else 0.0,
        markers=int(moved.sum()),
    )


def likeliest_onset(progress: Vector) -> int:
    """Return the maximum-likelihood onset of a drift that lasts to the end, in windows.

    For Gaussian sums the likeliest time of change is the minimum of the running sum less a
    reference drift (Page, Biometrika 41, 1954). The reference is half the mean drift since then.

    Args:
        progress: ``(n + 1,)`` running sum along the contact's direction, from 0 windows on.
    """
    lowest = int(progress.argmin())
    slope = (progress[-1] - progress[lowest]) / max(len(progress) - 1 - lowest, 1)
    return int((progress - 0.5 * slope * np.arange(len(progress))).argmin())


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
        hot_pixels: How many hot pixels of each sensor's rims are ignored.
        test: As given.
    """

    def __init__(self, learned: QuietEvidence, test: ScaleTest) -> None:
        self.in_contact = False
        self.hot_pixels, self.test = learned.hot_pixels, test
        self._period_us = round(learned.period_s * 1e6)
        self._noise = [learned.marker_noise(sensor) for sensor in range(len(learned.tables))]
        self._evidence = EvidenceSums(learned.tables, int(test.windows[-1]))
        self._sums = ScaleSums(test)
        self._release: ReleaseMonitor | None = None
        self._begun: tuple[int, Vector] | None = None
        self._along = test.mean
        self._calm: int | None = None
        self._end_us = 0
        self._summary = DetectorSummary(
            rule="a contact is a common motion of the markers whose squared whitened evidence "
            f"exceeds its threshold, {test.threshold.min():.0f} or more, on one of "
            f"{len(test.windows)} time scales",
            figures={
                "hot_pixels": list(self.hot_pixels),
                "scales_ms": [int(n * self._period_us / 1e3) for n in test.windows],
                "thresholds": [round(float(value), 3) for value in test.threshold],
            },
        )
        exceeded_kernel(np.zeros(len(test.threshold)), test.threshold)  # compiled now, not later

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
        tables = [rim_table(calibration) for calibration in calibrations]
        counter = WindowCounter()
        learned = quiet_evidence(tables, counter.counted(quiet))
        detector = cls(learned, scale_test(learned, alarms_per_hour))
        detector._summary = replace(detector._summary, quiet=counter.statistics())
        return detector

    def update(self, window: Window) -> Contact | None:
        """Return the contact that begins in a window, if one does."""
        self._prepare_release()
        evidence = self._evidence.add(window)
        values = self._sums.add(evidence)
        self._end_us = packets_of(window)[0].t_end_us
        scale = exceeded_kernel(values, self.test.threshold)
        if self._release is not None:
            scale = self._follow(self._release, evidence, scale)
        return None if scale < 0 else self._begin(scale, values)

    def details(self) -> ContactDetails | None:
        """Return onset and place of the present contact, or None without one.

        It looks back over the longest scale, 0.26 s; the estimate improves while the contact
        lasts. Ask after the stop was sent.
        """
        self._prepare_release()
        if self._release is None:
            return None
        course = self._sums.course(self._along)
        windows = len(course) - 1 - likeliest_onset(course)
        recent = self._evidence.recent(windows)
        touches = tuple(
            gel_touch(evidence, table.center_px, windows * noise)
            for evidence, table, noise in zip(
                recent, self._evidence.tables, self._noise, strict=True
            )
        )
        return ContactDetails(self._end_us - windows * self._period_us, touches)

    def summary(self) -> DetectorSummary:
        """Return hot pixels, time scales and thresholds, and the quiet windows they came from."""
        return self._summary

    def reset(self) -> None:
        """Forget the past windows, but keep what was learned from the quiet ones."""
        self.in_contact = False
        self._release, self._calm, self._begun = None, None, None
        self._evidence.reset()
        self._sums.reset()

    def _begin(self, scale: int, values: Vector) -> Contact:
        self._begun = scale, self._sums.total(scale)
        self.in_contact, self._calm = True, None
        return Contact(self._end_us, float(values[scale]), float(self.test.threshold[scale]))

    def _prepare_release(self) -> None:
        """Begin to follow a contact; done after the stop was sent, since it takes a while."""
        if self._begun is None:
            return
        (scale, total), self._begun = self._begun, None
        markers = sum(len(table.center_px) for table in self._evidence.tables)
        self._release = ReleaseMonitor(self.test.mean, total, markers)
        self._along = self.test.whiten[scale].T @ (self.test.whiten[scale] @ total)

    def _follow(self, release: ReleaseMonitor, evidence: Vector, scale: int) -> int:
        """Follow a contact; return the scale that found the next one, or -1.

        Once the markers have come back, the contact ends when they rest or move away again.
        """
        release.add(evidence)
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
        if self._calm >= REST_WINDOWS:
            self._release, self._calm, self.in_contact = None, None, False
        return -1
