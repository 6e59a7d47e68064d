"""From readings to a hole: exact without noise, honest and steady with measured contact errors."""

import math

import numpy as np
import pytest

from spikingtac.geometry.hole import Compensation, HoleFitConfig, hexagon_reach_mm
from spikingtac.geometry.touch_fit import TouchFitConfig, estimate_hole
from spikingtac.geometry.travel import TravelModel, fit_travel
from stand_ins.touching import IdealProber

HEADING_RAD = math.pi / 3 * 30 / 120
OPEN = TouchFitConfig(prior=HoleFitConfig(radius_sigma_mm=math.inf, center_sigma_mm=math.inf))

# Errors of 30 touches of a flat wall by the default detector on the twin (simulated, seed 1001,
# preset typical), without the arm's repeatability, um.
MEASURED_UM = (
    3, -3, 18, 2, 7, -7, -3, 49, -3, -4, 33, 7, -33, 13, -21, -26, 1, -44, 11, 23, -16, -9, 2, -6,
    -8, 13, -1, 13, -8, -1,
)  # fmt: skip
REPEATABILITY_MM = 0.028


def known_travel(travel_mm: float = 0.12, sigma_mm: float = 0.03) -> TravelModel:
    flat = TravelModel.of(Compensation(travel_mm=travel_mm))
    return TravelModel(
        harmonics_mm=flat.harmonics_mm,
        covariance_mm2=flat.covariance_mm2,
        sigma_mm=sigma_mm,
        heading_rad=HEADING_RAD,
    )


def touched(
    prober: IdealProber, start: np.ndarray, angle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    reading = np.array([prober.touch(start, unit).reading_mm for unit in direction])
    return reading, direction


@pytest.mark.parametrize("radius_mm", [0.7, 2.0, 5.0])
def test_a_hexagon_of_known_heading_is_undone_to_a_micrometre(radius_mm: float) -> None:
    prober = IdealProber(radius_mm, center_mm=(0.2, -0.1), heading_rad=HEADING_RAD)
    start = np.array([0.2, -0.1]) + 0.05 * (radius_mm - 0.433)
    reading, direction = touched(prober, start, np.arange(5) * 2 * np.pi / 5)
    hole = estimate_hole(reading, direction, start, known_travel(), OPEN)
    np.testing.assert_allclose(hole.center_mm, [0.2, -0.1], atol=1.5e-3)
    assert hole.radius_mm == pytest.approx(radius_mm, abs=1.5e-3)


@pytest.mark.parametrize(("contacts", "trials"), [(4, 700), (12, 300)])
def test_no_divergence_and_honest_regions_with_measured_errors(contacts: int, trials: int) -> None:
    """A thousand holes, errors resampled from measured ones, calibration by measured touches."""
    rng = np.random.default_rng(1000 + contacts)
    covered, error = 0, []
    sector = np.tile(np.radians([0, 25, 50, -25, -50, 180, 155, 130, 205, 230]), 3)
    for _ in range(trials):
        heading = rng.uniform(0, np.pi / 3)
        excess = 0.12 - hexagon_reach_mm(0.75, sector - heading)
        travel = fit_travel(sector, excess + _errors(rng, len(sector)))
        radius = rng.uniform(0.7, 5.0)
        prober = IdealProber(radius, heading_rad=heading, noise_mm=_errors(rng, contacts).tolist())
        side = np.arange(contacts) % 2 * np.pi + rng.uniform(-0.9, 0.9, contacts)
        side[:4] = np.radians([45, 225, 135, 315])
        start = rng.uniform(-0.05, 0.05, 2)
        reading, direction = touched(prober, start, side)
        hole = estimate_hole(reading, direction, start, travel, TouchFitConfig())
        away = np.append(hole.center_mm, hole.radius_mm - radius)
        covered += away @ np.linalg.solve(hole.covariance_mm2, away) < 7.8147
        error.append(away)
    error_mm = np.array(error)
    assert np.abs(error_mm).max() < 0.2
    assert 0.90 <= covered / trials <= 0.99
    assert np.sqrt((error_mm[:, :2] ** 2).sum(axis=1).mean()) < (0.06 if contacts == 4 else 0.03)


def test_one_false_contact_among_twelve_moves_the_hole_little() -> None:
    prober = IdealProber(2.0, heading_rad=HEADING_RAD, noise_mm=[0.0] * 8 + [-0.3])
    reading, direction = touched(prober, np.zeros(2), np.arange(12) * np.pi / 6)
    off = []
    for doubt_sigma in (3.0, math.inf):
        config = TouchFitConfig(prior=OPEN.prior, doubt_sigma=doubt_sigma)
        hole = estimate_hole(reading, direction, np.zeros(2), known_travel(), config)
        off.append(float(np.linalg.norm(hole.center_mm)))
    assert off[0] < 0.4 * off[1]
    assert off[1] == pytest.approx(2.0 / 12.0 * 0.3, rel=0.1)


def _errors(rng: np.random.Generator, count: int) -> np.ndarray:
    measured = rng.choice(np.array(MEASURED_UM) / 1000.0, count)
    return measured + rng.normal(0.0, REPEATABILITY_MM, count)
