"""Lines of vibration in synthetic displacements, and none in noise."""

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.touch.field import FieldGauge, GradientOperator
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


def test_a_window_that_is_not_full_says_nothing() -> None:
    monitor = VibrationMonitor(1_000.0)
    monitor.update(0, np.zeros((MARKERS, 2)))
    assert monitor.spectrum() is None
    with pytest.raises(ConfigError, match="must be positive"):
        VibrationMonitor(0.0)


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


X, Y = np.meshgrid(np.arange(8.0), np.arange(8.0))
REFERENCE = 37.0 * np.column_stack([X.ravel(), Y.ravel()])


def test_quantities_of_a_known_field() -> None:
    away = REFERENCE - REFERENCE.mean(axis=0)
    moved = 0.02 * away + 0.01 * away @ [[0.0, 1.0], [-1.0, 0.0]] + [3.0, -1.0]
    found = FieldGauge(REFERENCE, 0.1).measure(moved)
    assert found.mean_shear_x_px.value == pytest.approx(3.0)
    assert found.mean_shear_y_px.value == pytest.approx(-1.0)
    assert found.torsion_rad.value == pytest.approx(np.arctan2(0.01, 1.02))
    assert found.divergence.value == pytest.approx(0.04)
    assert found.curl.value == pytest.approx(0.02)


def test_their_uncertainty_is_that_of_repeated_noise() -> None:
    rng, gauge = np.random.default_rng(5), FieldGauge(REFERENCE, 0.2)
    away = REFERENCE - REFERENCE.mean(axis=0)
    for stretch in (0.0, 0.005, 0.05):
        moved = stretch * away * [1.0, 0.0]
        found = [gauge.measure(moved + rng.normal(0.0, 0.2, (MARKERS, 2))) for _ in range(400)]
        for name in ("mean_shear_x_px", "torsion_rad", "divergence", "curl", "strain"):
            values = np.array([getattr(one, name).value for one in found])
            told = np.mean([getattr(one, name).sigma for one in found])
            assert values.std() == pytest.approx(told, rel=0.15), (name, stretch)


def test_noise_is_taken_off_the_strain() -> None:
    rng, gauge = np.random.default_rng(6), FieldGauge(REFERENCE, 0.2)
    away = REFERENCE - REFERENCE.mean(axis=0)
    for stretch in (0.005, 0.05):
        moved = stretch * away * [1.0, 0.0]
        noisy = [moved + rng.normal(0.0, 0.2, (MARKERS, 2)) for _ in range(400)]
        strain = np.mean([gauge.measure(one).strain.value for one in noisy])
        exact = float(GradientOperator(REFERENCE).of(moved).strength)
        assert strain == pytest.approx(exact, rel=0.02)
