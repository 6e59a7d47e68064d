"""The frame-based baseline of the collision experiment: displacement sum at 32 fps (section V-B).

``D(t) = sum_i |p_i(t) - p_i,init|``. Contact is detected where it exceeds the upper bound of an
interval without contact. Frames are not simulated: the true centres of the markers replace the
measurement of a camera with a global shutter and without exposure time, plus a declared measurement
noise. This favours the baseline.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from spikingtac.arrays import FloatArray

SECONDS_PER_HOUR = 3600.0
MIN_FRAMES = 50
"""Smallest number of frames without contact: fewer do not give a standard deviation to 10 %."""


@dataclass(frozen=True, kw_only=True)
class FrameSamplingConfig:
    """Settings of the frame camera.

    Attributes:
        rate_hz: Frames per second (32: section V-B of the paper, on GelStereo 2.0).
        noise_px: Standard deviation of a measured centre per axis, px (assumed: centroids of dots a
            dozen pixels wide reach 0.02 to 0.1 px in frames; see the assumptions).
        first_frames: Number of frames whose mean gives the initial coordinates.
        false_alarms_per_hour: False-alarm budget of the threshold, the same as that of the event
            detectors.
    """

    rate_hz: float = 32.0
    noise_px: float = 0.1
    first_frames: int = 3
    false_alarms_per_hour: float = 1.0

    def __post_init__(self) -> None:
        if not self.rate_hz > 0.0 or self.noise_px < 0.0 or self.first_frames < 1:
            raise ValueError("rate_hz must be positive, noise_px not negative, first_frames >= 1")

    @property
    def period_us(self) -> float:
        """Time between two frames, us."""
        return 1e6 / self.rate_hz


def displacement_sum_px(frames_px: FloatArray, initial_px: FloatArray) -> FloatArray:
    """Return the published ``D(t)`` ``(n,)`` of frames ``(n, m, 2)``, px."""
    away = frames_px - initial_px
    return np.hypot(away[:, :, 0], away[:, :, 1]).sum(axis=1)


def exposures_us(config: FrameSamplingConfig, phase: float, from_us: int, to_us: int) -> FloatArray:
    """Return the times of the frames in ``[from_us, to_us)``, us.

    Args:
        config: Settings of the camera.
        phase: Phase of the first frame after time zero, as a fraction of a period, 0 to 1.
        from_us: Start, us.
        to_us: End, us.
    """
    first = math.ceil(from_us / config.period_us - phase)
    last = math.ceil(to_us / config.period_us - phase)
    return np.asarray((np.arange(first, last) + phase) * config.period_us, np.float64)


def measured_px(
    config: FrameSamplingConfig, times_us: FloatArray, truth: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
) -> FloatArray:  # fmt: skip
    """Return the measured centres ``(n, m, 2)`` in frames, px.

    Args:
        config: Settings of the camera.
        times_us: ``(n,)`` exposures, us.
        truth: Times ``(k,)``, us, and true centres ``(k, m, 2)``, px, which are interpolated.
        rng: Source of the measurement noise.
    """
    known_us, centers = truth
    right = np.clip(np.searchsorted(known_us, times_us), 1, len(known_us) - 1)
    fraction = (times_us - known_us[right - 1]) / (known_us[right] - known_us[right - 1])
    weight = np.clip(fraction, 0.0, 1.0)[:, None, None]
    exact = (1.0 - weight) * centers[right - 1] + weight * centers[right]
    return exact + rng.normal(0.0, config.noise_px, exact.shape)


def quiet_threshold_px(config: FrameSamplingConfig, sums_px: Sequence[float] | FloatArray) -> float:
    """Return the upper bound of the displacement sum without contact, px.

    It is the highest sum in the frames, or the normal tail at the budget if that is higher: the
    highest sum of one minute alone would be exceeded about once a minute.

    Args:
        config: Settings of the camera.
        sums_px: ``(n,)`` displacement sums without contact, px.

    Raises:
        ValueError: There are fewer than :data:`MIN_FRAMES` frames.
    """
    sums = np.asarray(sums_px, np.float64)
    if len(sums) < MIN_FRAMES:
        raise ValueError(f"{len(sums)} quiet frames are too few, at least {MIN_FRAMES} are needed")
    chance = config.false_alarms_per_hour / (config.rate_hz * SECONDS_PER_HOUR)
    tail = sums.mean() + float(norm.isf(chance)) * sums.std(ddof=1)
    return float(max(sums.max(), tail))


class FrameSampler:
    """Evaluates frames in order and returns the first one that shows contact.

    Args:
        config: Settings of the camera.
        threshold_px: Threshold of the displacement sum, px.
        phase: Phase of its frames, as a fraction of a period.
        rng: Source of the measurement noise.
    """

    def __init__(
        self,
        config: FrameSamplingConfig,
        threshold_px: float,
        phase: float,
        rng: np.random.Generator,
    ) -> None:
        self._config, self._threshold = config, threshold_px
        self._phase, self._rng = phase, rng
        self._initial = np.empty(0)

    def start(self, centers_px: FloatArray) -> None:
        """Set the initial coordinates ``(m, 2)``, px: a mean over some frames without contact."""
        spread = self._config.noise_px / math.sqrt(self._config.first_frames)
        self._initial = centers_px + self._rng.normal(0.0, spread, centers_px.shape)

    def look(self, truth: tuple[FloatArray, FloatArray]) -> float | None:
        """Return the exposure at which contact shows, us, or None.

        Args:
            truth: Times ``(k,)``, us, and true centres ``(k, m, 2)``, px. Give each stretch of time
                once.
        """
        times = exposures_us(self._config, self._phase, int(truth[0][0]), int(truth[0][-1]))
        if not len(times):
            return None
        sums = displacement_sum_px(
            measured_px(self._config, times, truth, self._rng), self._initial
        )
        beyond = np.flatnonzero(sums > self._threshold)
        return float(times[beyond[0]]) if len(beyond) else None
