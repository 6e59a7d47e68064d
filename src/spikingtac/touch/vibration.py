"""Vibration of the skin: spectrum of the markers' mean motion, and its strongest line, if any."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac.types import US_PER_S, FloatArray, one_line

# Fewer frames make no spectrum: below 128 frames a second a window of 0.5 s is longer.
LEAST_FRAMES = 64
LOWEST_HZ = 10.0  # Motions slower than this are touch, not vibration, Hz.

# Amplitude of a line over the median of the spectrum (white noise exceeds 5 once in 4,000
# spectra of 250 bins).
LINE_RATIO = 6.0

# Share of a period by which a frame may come earlier or later than expected (times are
# rounded to 1 us; a frame that is missing breaks the wave).
IRREGULAR_SHARE = 0.25


@dataclass(frozen=True, slots=True)
class Spectrum:
    """The motion of the skin by frequency.

    Attributes:
        t_us: Time of the last frame in it, us.
        frequency_hz: ``(f,)`` frequencies, Hz, up to half of the tracking rate.
        amplitude_px: ``(f,)`` amplitude of a sine in each bin, px.
        noise_px: Median of the amplitudes from 10 Hz on, px.
        line_hz: Frequency of the strongest line, Hz; None where nothing stands out of the noise.
        line_px: Its amplitude, px; 0 without a line.
    """

    t_us: int
    frequency_hz: FloatArray
    amplitude_px: FloatArray
    noise_px: float
    line_hz: float | None
    line_px: float

    __repr__ = one_line


class VibrationMonitor:
    """Keeps the last frames and computes their spectrum on request.

    Example:
        >>> monitor = VibrationMonitor(1_000.0)
        >>> for k in range(500):
        ...     shift = 0.1 * np.sin(2 * np.pi * 120.0 * k / 1e3)
        ...     monitor.update(k * 1_000, np.full((4, 2), [shift, 0.0]))
        >>> found = monitor.spectrum()
        >>> round(found.line_hz), round(found.line_px, 2)
        (120, 0.1)
    """

    def __init__(self, rate_hz: float, window_s: float = 0.5) -> None:
        """Start empty.

        Args:
            rate_hz: Frames per second.
            window_s: Length of the spectrum, s, or 64 frames where that is longer.

        Raises:
            ConfigError: The rate is not positive.
        """
        if not rate_hz > 0:
            raise ConfigError(f"the rate is {rate_hz} frames per second, it must be positive")
        self._period_us = US_PER_S / rate_hz
        self._frames = max(round(window_s * rate_hz), LEAST_FRAMES)
        self._times: deque[int] = deque(maxlen=self._frames)
        self._places: deque[FloatArray] = deque(maxlen=self._frames)

    @property
    def window_us(self) -> int:
        """Length of the window, us."""
        return round(self._frames * self._period_us)

    def update(self, t_us: int, displacement: FloatArray) -> None:
        """Take in displacements ``(m, 2)``, px; the window begins anew after a gap in time."""
        if self._times:
            late_us = t_us - self._times[-1] - self._period_us
            if abs(late_us) > IRREGULAR_SHARE * self._period_us:
                self._times.clear()
                self._places.clear()
        self._times.append(t_us)
        self._places.append(np.add.reduce(displacement, axis=0) / len(displacement))

    def spectrum(self) -> Spectrum | None:
        """Return the spectrum of the last window, or None until there is one."""
        if len(self._places) < self._frames:
            return None
        # A late import: every verb's start would wait for it.
        from scipy.signal import detrend, periodogram

        # The frames' own rate, not the declared one.
        rate_hz = (self._frames - 1) * US_PER_S / (self._times[-1] - self._times[0])
        moved = detrend(np.array(self._places), axis=0)
        frequency, power = periodogram(moved, rate_hz, "hann", scaling="spectrum", axis=0)
        amplitude = np.sqrt(2.0 * power.sum(axis=1))
        fast = frequency >= LOWEST_HZ
        noise = float(np.median(amplitude[fast])) if fast.any() else 0.0
        line_hz, line_px = _line(frequency, np.where(fast, amplitude, 0.0), noise)
        return Spectrum(self._times[-1], frequency, amplitude, noise, line_hz, line_px)


def _line(frequency: FloatArray, amplitude: FloatArray, noise: float) -> tuple[float | None, float]:
    """Return frequency and amplitude of the strongest line, between bins by a parabola.

    The window keeps a line within three bins; the logarithms of their amplitudes lie on a parabola
    (F. J. Harris, "On the use of windows for harmonic analysis", Proc. IEEE 66, 1978).
    """
    best = int(amplitude.argmax())
    if not 0 < best < len(amplitude) - 1 or amplitude[best] <= LINE_RATIO * noise:
        return None, 0.0
    left, top, right = np.log(np.maximum(amplitude[best - 1 : best + 2], 1e-12))
    bend = float(left - 2.0 * top + right)
    shift = 0.5 * float(left - right) / bend if bend < 0.0 else 0.0
    height = float(np.exp(top - 0.25 * (left - right) * shift))
    return float((best + shift) * frequency[1]), height
