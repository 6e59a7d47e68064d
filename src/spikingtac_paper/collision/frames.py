"""The frame-based baseline of the collision experiment: displacement sum at 32 fps (section V-B).

``D(t) = sum_i |p_i(t) - p_i,init|``. Contact is detected where it exceeds the upper bound of an
interval without contact. Frames are not simulated: the true centres of the markers replace the
measurement of a camera with a global shutter and without exposure time, plus a declared measurement
noise. This favours the baseline.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from spikingtac.arrays import FloatArray

RATE_HZ = 32.0  # Frames per second (section V-B of the paper, on GelStereo 2.0).
PERIOD_US = 1e6 / RATE_HZ  # Time between two frames, us.

# Standard deviation of a measured centre per axis, px (assumed: centroids of dots a dozen pixels
# wide reach 0.02 to 0.1 px in frames; see the assumptions).
NOISE_PX = 0.1
FIRST_FRAMES = 3  # Number of frames whose mean gives the initial coordinates.

# False-alarm budget of the threshold, the same as that of the event detectors.
FALSE_ALARMS_PER_HOUR = 1.0
SECONDS_PER_HOUR = 3600.0

# Smallest number of frames without contact: fewer do not give a standard deviation to 10 %.
MIN_FRAMES = 50
Truth = tuple[FloatArray, FloatArray]  # Times ``(k,)``, us, and true centres ``(k, m, 2)``, px.


def displacement_sum_px(frames_px: FloatArray, initial_px: FloatArray) -> FloatArray:
    """Return the published ``D(t)`` ``(n,)`` of frames ``(n, m, 2)``, px."""
    away = frames_px - initial_px
    return np.hypot(away[:, :, 0], away[:, :, 1]).sum(axis=1)


def exposures_us(phase: float, from_us: int, to_us: int) -> FloatArray:
    """Return the times of the frames in ``[from_us, to_us)``, us.

    Args:
        phase: Phase of the first frame after time zero, as a fraction of a period, 0 to 1.
        from_us: Start, us.
        to_us: End, us.
    """
    first = math.ceil(from_us / PERIOD_US - phase)
    last = math.ceil(to_us / PERIOD_US - phase)
    return np.asarray((np.arange(first, last) + phase) * PERIOD_US, np.float64)


def measured_px(times_us: FloatArray, truth: Truth, rng: np.random.Generator) -> FloatArray:
    """Return the measured centres ``(n, m, 2)`` in frames, px.

    Args:
        times_us: ``(n,)`` exposures, us.
        truth: The true centres, which are interpolated.
        rng: Source of the measurement noise.
    """
    known_us, centers = truth
    right = np.clip(np.searchsorted(known_us, times_us), 1, len(known_us) - 1)
    fraction = (times_us - known_us[right - 1]) / (known_us[right] - known_us[right - 1])
    weight = np.clip(fraction, 0.0, 1.0)[:, None, None]
    exact = (1.0 - weight) * centers[right - 1] + weight * centers[right]
    return exact + rng.normal(0.0, NOISE_PX, exact.shape)


def quiet_threshold_px(sums_px: Sequence[float] | FloatArray) -> float:
    """Return the upper bound of the displacement sum without contact, px.

    It is the highest sum in the frames, or the normal tail at the budget if that is higher: the
    highest sum of one minute alone would be exceeded about once a minute.

    Args:
        sums_px: ``(n,)`` displacement sums without contact, px.

    Raises:
        ValueError: There are fewer than :data:`MIN_FRAMES` frames.
    """
    sums = np.asarray(sums_px, np.float64)
    if len(sums) < MIN_FRAMES:
        raise ValueError(f"{len(sums)} quiet frames are too few, at least {MIN_FRAMES} are needed")
    chance = FALSE_ALARMS_PER_HOUR / (RATE_HZ * SECONDS_PER_HOUR)
    tail = sums.mean() + float(norm.isf(chance)) * sums.std(ddof=1)
    return float(max(sums.max(), tail))


class FrameSampler:
    """Evaluates frames in order and returns the first one that shows contact.

    Args:
        threshold_px: Threshold of the displacement sum, px.
        phase: Phase of its frames, as a fraction of a period.
        rng: Source of the measurement noise.
    """

    def __init__(self, threshold_px: float, phase: float, rng: np.random.Generator) -> None:
        self._threshold, self._phase, self._rng = threshold_px, phase, rng
        self._initial = np.empty(0)

    def start(self, centers_px: FloatArray) -> None:
        """Set the initial coordinates ``(m, 2)``, px: a mean over some frames without contact."""
        spread = NOISE_PX / math.sqrt(FIRST_FRAMES)
        self._initial = centers_px + self._rng.normal(0.0, spread, centers_px.shape)

    def look(self, truth: Truth) -> float | None:
        """Return the exposure at which contact shows, us, or None.

        Args:
            truth: The true centres; give each stretch of time once.
        """
        times = exposures_us(self._phase, int(truth[0][0]), int(truth[0][-1]))
        if not len(times):
            return None
        sums = displacement_sum_px(measured_px(times, truth, self._rng), self._initial)
        beyond = np.flatnonzero(sums > self._threshold)
        return float(times[beyond[0]]) if len(beyond) else None
