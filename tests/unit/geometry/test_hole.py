"""Circles and holes: exact without noise, honest with it, steady for clustered contacts."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikingtac.geometry.hole import (
    HoleFitConfig,
    fit_circle,
)

SIGMA_MM = 0.03
OPEN = HoleFitConfig(radius_sigma_mm=math.inf, center_sigma_mm=math.inf)


def on_circle(center: tuple[float, float], radius: float, angle: np.ndarray) -> np.ndarray:
    return np.array(center) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


@given(
    radius=st.floats(0.3, 6.0),
    x=st.floats(-3.0, 3.0),
    y=st.floats(-3.0, 3.0),
    turn=st.floats(0.0, 6.0),
    count=st.integers(3, 12),
)
@settings(max_examples=60, deadline=None)
def test_exact_on_noise_free_data(
    radius: float, x: float, y: float, turn: float, count: int
) -> None:
    angle = turn + np.arange(count) * 2 * np.pi / count
    circle = fit_circle(
        on_circle((x, y), radius, angle), np.array([x + 0.8 * radius, y]), OPEN, SIGMA_MM
    )
    np.testing.assert_allclose(circle.center_mm, [x, y], atol=1e-7)
    assert circle.radius_mm == pytest.approx(radius, abs=1e-7)
    assert np.abs(circle.residual_mm).max() < 1e-7


def test_covariance_is_the_closed_form_of_even_contacts() -> None:
    """n contacts around a circle: var(centre) = 2 sigma^2 / n per axis, var(radius) sigma^2 / n."""
    for count in (4, 12):
        angle = np.arange(count) * 2 * np.pi / count
        circle = fit_circle(on_circle((0, 0), 2.0, angle), np.zeros(2), OPEN, SIGMA_MM)
        expected = 0.03 * np.sqrt([2 / count, 2 / count, 1 / count])
        np.testing.assert_allclose(circle.sigma_mm, expected, rtol=1e-6)


@pytest.mark.parametrize("spread", [2 * np.pi, np.pi])
def test_the_stated_region_covers_the_truth(spread: float) -> None:
    rng = np.random.default_rng(5)
    config, covered, trials = HoleFitConfig(), 0, 600
    for _ in range(trials):
        radius = rng.normal(config.radius_mm, 0.5 * config.radius_sigma_mm)
        radius = min(max(radius, 0.7), 5.0)
        center = rng.uniform(-0.5, 0.5, 2) * radius
        angle = rng.uniform(0, 2 * np.pi) + np.linspace(0, spread, 6, endpoint=False)
        points = on_circle(tuple(center), radius, angle) + rng.normal(0, 0.03, (6, 2))
        circle = fit_circle(points, np.zeros(2), config, SIGMA_MM)
        away = np.append(circle.center_mm - center, circle.radius_mm - radius)
        covered += away @ np.linalg.solve(circle.covariance_mm2, away) < 7.815
    assert 0.92 < covered / trials < 0.98


@pytest.mark.parametrize("contacts", [3, 6])
def test_contacts_on_one_side_state_how_little_they_tell(contacts: int) -> None:
    """Some touch one wall only: the circle may come out small, its stated region must not."""
    rng = np.random.default_rng(8)
    config, covered, trials = HoleFitConfig(), 0, 600
    for _ in range(trials):
        radius = rng.uniform(config.radius_mm, 5.0)
        center = rng.uniform(-0.3, 0.3, 2) * radius
        angle = rng.uniform(0, 2 * np.pi) + np.linspace(0, 0.5, contacts)
        points = on_circle(tuple(center), radius, angle) + rng.normal(0, 0.03, (contacts, 2))
        circle = fit_circle(points, np.zeros(2), config, SIGMA_MM)
        away = np.append(circle.center_mm - center, circle.radius_mm - radius)
        covered += away @ np.linalg.solve(circle.covariance_mm2, away) < 7.815
    assert covered / trials > 0.95


def test_unfit_input_is_refused() -> None:
    with pytest.raises(ValueError, match="need"):
        fit_circle(np.zeros((0, 2)), np.zeros(2), OPEN, SIGMA_MM)
    with pytest.raises(ValueError, match="finite"):
        fit_circle(np.full((3, 2), np.nan), np.zeros(2), OPEN, SIGMA_MM)
