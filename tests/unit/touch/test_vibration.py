"""Lines of vibration in synthetic displacements, and none in noise."""

import numpy as np
import pytest

from spikingtac.touch.vibration import Spectrum, VibrationMonitor

MARKERS = 64


def spectrum_of(monitor: VibrationMonitor, t_us: np.ndarray, moved: np.ndarray) -> Spectrum:
    """Return the spectrum after displacements ``(n,)`` of all markers alike, or of each."""
    for at_us, shift in zip(t_us.tolist(), moved, strict=True):
        monitor.update(at_us, np.broadcast_to(shift, (MARKERS, 2)))
    found = monitor.spectrum()
    assert found is not None
    return found


def heard(amplitude_px: float, hz: float, seed: int = 0, rate_hz: float = 1_000.0) -> Spectrum:
    t_s = np.arange(round(0.6 * rate_hz))[:, None, None] / rate_hz
    shift = amplitude_px * np.sin(2.0 * np.pi * hz * t_s) * np.array([0.6, 0.8])
    noise = np.random.default_rng(seed).normal(0.0, 0.05, (len(t_s), MARKERS, 2))
    moved = shift + 2.0 * t_s**2 + noise
    return spectrum_of(VibrationMonitor(rate_hz), (1e6 * t_s.ravel()).round().astype(int), moved)


@pytest.mark.parametrize("hz", [20.0, 240.3, 497.0])
def test_a_line_is_found_between_the_bins(hz: float) -> None:
    found = heard(0.77, hz, rate_hz=2_000.0 if hz > 400.0 else 1_000.0)
    assert found.line_hz == pytest.approx(hz, abs=1.0)
    assert found.line_px == pytest.approx(0.77, rel=0.1)


def test_noise_is_no_line() -> None:
    assert sum(heard(0.0, 1.0, seed).line_hz is not None for seed in range(20)) == 0


def test_slow_frames_make_a_longer_window() -> None:
    monitor, k = VibrationMonitor(50.0), np.arange(64)
    shift = 0.5 * np.sin(2.0 * np.pi * 17.0 * k / 50.0)
    for step in range(63):
        monitor.update(20_000 * step, np.full((MARKERS, 2), shift[step]))
        assert monitor.spectrum() is None
    assert spectrum_of(monitor, 20_000 * k[63:], shift[63:]).line_hz == pytest.approx(17.0, abs=0.2)
    # Below 7.5 Hz there is touch, and no vibration.
    assert spectrum_of(VibrationMonitor(15.0), 66_667 * k, 0.1 * (k % 3)).line_hz is None


@pytest.mark.parametrize("period_us", [850, 1_000, 1_150])
def test_the_frequency_is_that_of_the_times(period_us: int) -> None:
    t_us = period_us * np.arange(600)
    shift = 0.1 * np.sin(2e-6 * np.pi * 60.0 * t_us)
    assert spectrum_of(VibrationMonitor(1e3), t_us, shift).line_hz == pytest.approx(60.0, abs=0.2)
