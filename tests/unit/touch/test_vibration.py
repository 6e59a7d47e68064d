"""Lines of vibration in synthetic displacements, and none in noise."""

import numpy as np
import pytest

from spikingtac.touch.vibration import Spectrum, VibrationMonitor

MARKERS = 64


def heard(amplitude_px: float, hz: float, seed: int = 0, rate_hz: float = 1_000.0) -> Spectrum:
    rng, monitor = np.random.default_rng(seed), VibrationMonitor(rate_hz)
    for k in range(round(0.6 * rate_hz)):
        t_s = k / rate_hz
        shift = amplitude_px * np.sin(2.0 * np.pi * hz * t_s) * np.array([0.6, 0.8])
        drift = 2.0 * t_s**2
        moved = shift + drift + rng.normal(0.0, 0.05, (MARKERS, 2))
        monitor.update(round(t_s * 1e6), moved)
    found = monitor.spectrum()
    assert found is not None
    return found


@pytest.mark.parametrize("hz", [20.0, 240.3, 497.0])
def test_a_line_is_found_between_the_bins(hz: float) -> None:
    found = heard(0.77, hz, rate_hz=2_000.0 if hz > 400.0 else 1_000.0)
    assert found.line_hz == pytest.approx(hz, abs=1.0)
    assert found.line_px == pytest.approx(0.77, rel=0.1)


def test_noise_is_no_line() -> None:
    assert sum(heard(0.0, 1.0, seed).line_hz is not None for seed in range(20)) == 0


def test_slow_frames_make_a_longer_window() -> None:
    monitor = VibrationMonitor(50.0)
    for k in range(64):
        assert monitor.spectrum() is None
        shift = 0.5 * np.sin(2.0 * np.pi * 17.0 * k / 50.0)
        monitor.update(20_000 * k, np.full((MARKERS, 2), [shift, 0.0]))
    found = monitor.spectrum()
    assert found is not None
    assert found.line_hz == pytest.approx(17.0, abs=0.2)
    slower = VibrationMonitor(15.0)  # below 7.5 Hz there is touch, and no vibration
    for k in range(64):
        slower.update(round(1e6 * k / 15.0), np.full((MARKERS, 2), 0.1 * (k % 3)))
    lowest = slower.spectrum()
    assert lowest is not None
    assert lowest.line_hz is None


@pytest.mark.parametrize("period_us", [850, 1_000, 1_150])
def test_the_frequency_is_that_of_the_times(period_us: int) -> None:
    monitor = VibrationMonitor(1_000.0)
    for k in range(600):
        shift = 0.1 * np.sin(2e-6 * np.pi * 60.0 * period_us * k)
        monitor.update(period_us * k, np.full((MARKERS, 2), shift))
    found = monitor.spectrum()
    assert found is not None
    assert found.line_hz == pytest.approx(60.0, abs=0.2)
