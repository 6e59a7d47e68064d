"""Vibration of the skin: spectrum of the markers' motion, and its strongest line, if any.

The mean displacement of the markers carries what all share; its noise is smaller than a marker's
by the root of their number. A Hann window keeps a line's energy within three bins; its frequency
between bins follows from the logarithms of their amplitudes (F. J. Harris, "On the use of windows
for harmonic analysis", Proc. IEEE 66, 1978).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError

Field = NDArray[np.float64]

US_PER_S = 1e6
UM_PER_MM = 1e3
LEAST_FRAMES = 64
"""Fewer frames make no spectrum: below 128 frames a second its window is longer."""
IRREGULAR_SHARE = 0.25
"""Share of a period by which a frame may come earlier or later than expected (ours: times are
rounded to 1 us; a frame that is missing breaks the wave). Frequencies follow from the times."""


@dataclass(frozen=True, kw_only=True)
class VibrationConfig:
    """How vibration is measured.

    Attributes:
        window_s: Length of the spectrum, s (ours: 0.5 s has bins of 2 Hz), or 64 frames where
            that is longer.
        lowest_hz: Motions slower than this are touch, not vibration, Hz (ours).
        line_ratio: Amplitude of a line over the median of the spectrum that is no noise (ours:
            white noise exceeds 5 once in 4,000 spectra of 250 bins).
    """

    window_s: float = 0.5
    lowest_hz: float = 10.0
    line_ratio: float = 6.0

    def __post_init__(self) -> None:
        if not self.window_s > 0 or not self.lowest_hz > 0 or not self.line_ratio > 1:
            raise ValueError("window_s and lowest_hz must be positive, line_ratio above 1")


@dataclass(frozen=True, slots=True)
class Spectrum:
    """The motion of the skin by frequency.

    Attributes:
        t_us: Time of the last frame in it, us.
        frequency_hz: ``(f,)`` frequencies, Hz, up to half of the tracking rate.
        amplitude_px: ``(f,)`` amplitude of a sine in each bin, px.
        line_hz: Frequency of the strongest line, Hz; None where nothing stands out of the noise.
        line_px: Its amplitude, px; 0 without a line.
    """

    t_us: int
    frequency_hz: Field
    amplitude_px: Field
    line_hz: float | None
    line_px: float

    def line_um(self, px_per_mm: float) -> float:
        """Return the amplitude of the strongest line, um."""
        return self.line_px / px_per_mm * UM_PER_MM


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

    def __init__(self, rate_hz: float, config: VibrationConfig | None = None) -> None:
        """Start empty.

        Args:
            rate_hz: Frames per second.
            config: How vibration is measured.

        Raises:
            ConfigError: The rate is not positive.
        """
        if not rate_hz > 0:
            raise ConfigError(f"the rate is {rate_hz} frames per second, it must be positive")
        self._rate, self._config = rate_hz, config or VibrationConfig()
        frames = max(round(self._config.window_s * rate_hz), LEAST_FRAMES)
        self._frames = frames
        self._times: deque[int] = deque(maxlen=frames)
        self._places: deque[Field] = deque(maxlen=frames)
        self._window = np.hanning(frames + 1)[:-1]

    def update(self, t_us: int, displacement: Field) -> None:
        """Take in displacements ``(m, 2)``, px; the window begins anew after a gap in time."""
        period_us = US_PER_S / self._rate
        if self._times:
            late_us = t_us - self._times[-1] - period_us
            if abs(late_us) > IRREGULAR_SHARE * period_us:
                self._times.clear()
                self._places.clear()
        self._times.append(t_us)
        self._places.append(np.add.reduce(displacement, axis=0) / len(displacement))

    def spectrum(self) -> Spectrum | None:
        """Return the spectrum of the last window, or None until there is one."""
        if len(self._places) < self._frames:
            return None
        moved = np.array(self._places)
        steps = np.linspace(-1.0, 1.0, self._frames)
        slow = np.polynomial.polynomial.polyfit(steps, moved, 2)
        moved = moved - np.polynomial.polynomial.polyval(steps, slow).T
        lines = np.fft.rfft(moved * self._window[:, None], axis=0)
        power = np.asarray((np.abs(lines) ** 2).sum(axis=1), np.float64)
        amplitude = 2.0 * np.sqrt(power) / float(self._window.sum())
        span_us = self._times[-1] - self._times[0]  # the frames' own rate, not the declared one
        rate_hz = (self._frames - 1) * US_PER_S / span_us
        frequency = np.arange(len(amplitude), dtype=np.float64) * (rate_hz / self._frames)
        line_hz, line_px = self._line(frequency, amplitude)
        return Spectrum(self._times[-1], frequency, amplitude, line_hz, line_px)

    def _line(self, frequency: Field, amplitude: Field) -> tuple[float | None, float]:
        fast = frequency >= self._config.lowest_hz
        if not fast.any():
            return None, 0.0
        heard = np.where(fast, amplitude, 0.0)
        best = int(heard.argmax())
        noise = float(np.median(amplitude[fast]))
        if not 0 < best < len(amplitude) - 1 or heard[best] <= self._config.line_ratio * noise:
            return None, 0.0
        left, top, right = np.log(np.maximum(amplitude[best - 1 : best + 2], 1e-12))
        bend = left - 2.0 * top + right
        shift = 0.5 * float(left - right) / float(bend) if bend < 0.0 else 0.0
        height = float(np.exp(top - 0.25 * (left - right) * shift))
        return float((best + shift) * frequency[1]), height
