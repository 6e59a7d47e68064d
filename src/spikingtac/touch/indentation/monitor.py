"""Growth of the discs and indentation of the skin while they happen, and the most of each touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.touch.field.local_gradient import GradientOperator
from spikingtac.touch.indentation.disc_growth import DiscGrowth, DiscGrowthGauge
from spikingtac.touch.indentation.field_features import FieldFeatures
from spikingtac.touch.indentation.indentation_law import fitted_law
from spikingtac.types import EventPacket, MarkerFrame

Field = NDArray[np.float64]

PERIOD_US = 10_000
"""Time between two measurements, us (ours: more tell nothing more)."""
STEADY_MEASUREMENTS = 5
"""Measurements whose median is the growth and the indentation of a touch (ours: 50 ms; single ones
would let noise choose the peak). A touch that has fewer is told by the median of those."""


@dataclass(frozen=True, slots=True)
class Indentation:
    """How the skin is pressed at one time.

    Attributes:
        t_us: The time, us.
        growth: ``(m,)`` growth of each disc's radius, as a share of the resting one.
        growth_sigma: ``(m,)`` one standard deviation of it.
        indentation_mm: ``(m,)`` indentation under each marker, mm; None where the camera's distance
            or the scale is not known.
        indentation_sigma_mm: ``(m,)`` one standard deviation of it, mm; None with it.
    """

    t_us: int
    growth: Field
    growth_sigma: Field
    indentation_mm: Field | None
    indentation_sigma_mm: Field | None


@dataclass(frozen=True, slots=True)
class Peak:
    """The most that was measured in a touch, with one standard deviation.

    Attributes:
        growth: Growth of the disc that grew most.
        growth_std: Its standard deviation.
        indentation_mm: Indentation under the marker that was pressed deepest, mm; None where it
            cannot be told.
        indentation_std_mm: Its standard deviation, mm; None with it.
    """

    growth: float
    growth_std: float
    indentation_mm: float | None
    indentation_std_mm: float | None


class SteadyPeak:
    """The most of a course of measurements, each the median of the latest few.

    Example:
        >>> peak = SteadyPeak()
        >>> for value in (0.5, 0.1, 0.1, 0.1, 0.2, 0.2):
        ...     peak.add(np.array([value]), np.array([0.01]))
        >>> peak.most()
        (0.1, 0.01)
    """

    def __init__(self) -> None:
        """Start with none."""
        self._recent: list[tuple[float, float]] = []
        self._most: tuple[float, float] | None = None

    def add(self, values: Field, sigmas: Field) -> None:
        """Take in a measurement: the largest of the values ``(m,)`` counts, with its sigma."""
        largest = int(np.argmax(values))
        self._recent.append((float(values[largest]), float(sigmas[largest])))
        del self._recent[:-STEADY_MEASUREMENTS]
        if len(self._recent) == STEADY_MEASUREMENTS:
            steady = _middle(self._recent)
            self._most = steady if self._most is None else max(self._most, steady)

    def most(self) -> tuple[float, float] | None:
        """Return the most and its sigma; of fewer measurements their median, None without any."""
        return _middle(self._recent) if self._most is None and self._recent else self._most


class IndentationMonitor:
    """Follows growth and indentation, causally; needs events, frames, and what is touched.

    Example:
        >>> monitor = IndentationMonitor(calibration, camera_distance_mm=13.0)  # doctest: +SKIP
        >>> for packet in packets:  # doctest: +SKIP
        ...     monitor.absorb(packet)  # up to the time of the frame
        >>> monitor.update(frame, detector.tracked_px, detector.touching)  # doctest: +SKIP
        >>> monitor.state.indentation_mm.max()  # doctest: +SKIP
        0.41

    Attributes:
        state: The last measurement; None before the first.
    """

    def __init__(self, calibration: Calibration, camera_distance_mm: float | None = None) -> None:
        """Begin at rest.

        Args:
            calibration: Where the markers rest, and how they look.
            camera_distance_mm: From the lens's centre of projection to the skin at rest, mm; None:
                growth only.

        Raises:
            ConfigError: The distance is not positive, or the calibration knows no contrast, edge or
                steps, or, where a distance is given, no scale.
        """
        self._calibration = calibration
        self._gauge = DiscGrowthGauge(calibration)
        # The optical axis is taken for the middle of the sensor.
        middle_px = (np.array(calibration.size) - 1.0) / 2.0
        self._features = FieldFeatures(calibration.reference_px, middle_px)
        self._gradient = GradientOperator(calibration.reference_px)
        self._pitch_mm, self._nearness = _scales(
            calibration, camera_distance_mm, self._features.pitch_px
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything: the markers are at the calibrated rest."""
        self._gauge.reset()
        self.state: Indentation | None = None
        self._next_us: int | None = None
        self._forget_touch()

    def absorb(self, packet: EventPacket) -> None:
        """Take in events.

        Raises:
            ConfigError: They are of another sensor.
        """
        self._gauge.absorb(packet)

    def update(self, frame: MarkerFrame, displacement_px: Field, touching: bool) -> None:
        """Take in a frame at the end of what was absorbed.

        Args:
            frame: The frame.
            displacement_px: ``(m, 2)`` of the markers from their rest, px.
            touching: Whether a touch is open.
        """
        if self._next_us is not None and frame.t_us < self._next_us:
            return
        self._next_us = frame.t_us + PERIOD_US
        grown = self._gauge.measure(frame.t_us, frame.detected_px, resting=not touching)
        self.state = self._told(grown, displacement_px, frame.coasted)
        if touching:
            self._keep(self.state, frame.coasted)

    def take_peak(self) -> Peak | None:
        """Return the most of the touch that is over, and forget it; None where nothing was seen."""
        growth, depth = self._grown.most(), self._deep.most()
        self._forget_touch()
        if growth is None:
            return None
        return Peak(*growth, *(depth or (None, None)))

    def _forget_touch(self) -> None:
        self._grown, self._deep = SteadyPeak(), SteadyPeak()

    def _told(self, grown: DiscGrowth, moved: Field, coasted: NDArray[np.bool_]) -> Indentation:
        if self._pitch_mm is None or self._nearness is None:
            return Indentation(grown.t_us, grown.growth, grown.sigma, None, None)
        # Nobody sees a coasted marker's rim: what its neighbours' places say of its growth.
        between = 0.5 * self._gradient.of(moved).divergence
        growth = np.where(coasted, between, grown.growth)
        depth, sigma = fitted_law()(self._features.of(moved, growth, self._nearness))
        depth_mm, sigma_mm = depth * self._pitch_mm, sigma * self._pitch_mm
        return Indentation(grown.t_us, grown.growth, grown.sigma, depth_mm, sigma_mm)

    def _keep(self, state: Indentation, coasted: NDArray[np.bool_]) -> None:
        seen = np.flatnonzero(~coasted)
        if not len(seen):
            return
        self._grown.add(state.growth[seen], state.growth_sigma[seen])
        if state.indentation_mm is not None and state.indentation_sigma_mm is not None:
            self._deep.add(state.indentation_mm[seen], state.indentation_sigma_mm[seen])


def _middle(measured: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the median, of an even number the lower one, with its sigma."""
    return sorted(measured)[(len(measured) - 1) // 2]


def _scales(
    calibration: Calibration, camera_distance_mm: float | None, pitch_px: float
) -> tuple[float | None, float | None]:
    """Return the pitch, mm, and the pitch over the camera's distance; None where not known."""
    if camera_distance_mm is None:
        return None, None
    if not camera_distance_mm > 0:
        raise ConfigError(f"the camera's distance is {camera_distance_mm} mm, it must be positive")
    if calibration.px_per_mm is None:
        raise ConfigError(
            "indentation in mm needs the scale of the image, which the calibration lacks; make one "
            "with: spikingtac calibrate RECORDING --pitch-mm 2.4"
        )
    pitch_mm = pitch_px / calibration.px_per_mm
    return pitch_mm, pitch_mm / camera_distance_mm
