"""Circles, travel and holes: exact without noise, honest with it, steady for bad contacts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikingtac.geometry.hole import PRIOR_RADIUS_MM, PRIOR_SIGMA_MM, estimate_hole, fit_circle
from spikingtac.geometry.travel import (
    TravelModel,
    fit_travel,
    hexagon_reach_in_hole_mm,
    hexagon_reach_mm,
)
from spikingtac.sim.rig.walls import Bit
from stand_ins.touching import IdealProber

SIGMA_MM = 0.03
NO_NOISE_MM = 1e-6  # against which the prior has no weight


def on_circle(center: tuple[float, float], radius: float, angle: np.ndarray) -> np.ndarray:
    return np.array(center) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


@given(
    radius=st.floats(0.3, 6.0),
    x=st.floats(-3.0, 3.0),
    y=st.floats(-3.0, 3.0),
    turn=st.floats(0.0, 6.0),
    count=st.integers(3, 12),
)
@settings(max_examples=60)
def test_exact_on_noise_free_data(
    radius: float, x: float, y: float, turn: float, count: int
) -> None:
    angle = turn + np.arange(count) * 2 * np.pi / count
    circle = fit_circle(
        on_circle((x, y), radius, angle), np.array([x + 0.8 * radius, y]), NO_NOISE_MM
    )
    np.testing.assert_allclose(circle.center_mm, [x, y], atol=1e-7)
    assert circle.radius_mm == pytest.approx(radius, abs=1e-7)
    assert np.abs(circle.residual_mm).max() < 1e-7


def covered(radii_mm: np.ndarray, reach: float, angles: np.ndarray) -> float:
    """Return the share of true circles that the stated region covers (95 % of chi square)."""
    rng, inside = np.random.default_rng(5), 0
    for radius in radii_mm:
        center, turn = rng.uniform(-reach, reach, 2) * radius, rng.uniform(0, 2 * np.pi)
        points = on_circle(tuple(center), radius, turn + angles)
        points += rng.normal(0, SIGMA_MM, points.shape)
        circle = fit_circle(points, np.zeros(2), SIGMA_MM)
        away = np.append(circle.center_mm - center, circle.radius_mm - radius)
        inside += away @ np.linalg.solve(circle.covariance_mm2, away) < 7.815
    return inside / len(radii_mm)


@pytest.mark.parametrize("spread", [2 * np.pi, np.pi])
def test_the_stated_region_covers_the_truth(spread: float) -> None:
    radii_mm = np.random.default_rng(6).normal(PRIOR_RADIUS_MM, 0.5 * PRIOR_SIGMA_MM[2], 600)
    angles = np.linspace(0, spread, 6, endpoint=False)
    assert 0.92 < covered(radii_mm.clip(0.7, 5.0), 0.5, angles) < 0.98


@pytest.mark.parametrize("contacts", [3, 6])
def test_contacts_on_one_side_state_how_little_they_tell(contacts: int) -> None:
    """Some touch one wall only: the circle may come out small, its stated region must not."""
    radii_mm = np.random.default_rng(8).uniform(PRIOR_RADIUS_MM, 5.0, 600)
    assert covered(radii_mm, 0.3, np.linspace(0, 0.5, contacts)) > 0.95


def test_unfit_input_is_refused() -> None:
    with pytest.raises(ValueError, match="need"):
        fit_circle(np.zeros((0, 2)), np.zeros(2), SIGMA_MM)
    with pytest.raises(ValueError, match="finite"):
        fit_circle(np.full((3, 2), np.nan), np.zeros(2), SIGMA_MM)
    with pytest.raises(ValueError, match="finite"):
        fit_travel(np.arange(9.0), np.full(9, np.nan))


FLATS_MM = 0.75
SECTOR_RAD = np.radians([0, 25, 50, -25, -50, 180, 155, 130, 205, 230])


def travel_at(angle: np.ndarray) -> np.ndarray:
    return 0.15 - 0.01 * np.cos(angle) + 0.02 * np.sin(angle) - 0.05 * np.cos(2 * angle)


def excess_at(angle: np.ndarray, heading: float) -> np.ndarray:
    return travel_at(angle) - hexagon_reach_mm(FLATS_MM, angle - heading)


@pytest.mark.parametrize("radius_mm", [0.7, 1.2, 5.0])
def test_the_reach_in_a_hole_is_where_the_corners_meet_it(radius_mm: float) -> None:
    corner = Bit(heading_rad=0.0).points_mm[:, :2]
    for angle in np.linspace(-4.0, 4.0, 41):
        reach = float(hexagon_reach_in_hole_mm(FLATS_MM, angle, radius_mm))
        center = (radius_mm - reach) * np.array([math.cos(angle), math.sin(angle)])
        assert np.linalg.norm(center + corner, axis=1).max() == pytest.approx(radius_mm, abs=1e-12)


def test_travel_and_heading_are_told_apart() -> None:
    heading = math.pi / 3 * 40 / 120
    model = fit_travel(np.tile(SECTOR_RAD, 3), np.tile(excess_at(SECTOR_RAD, heading), 3))
    assert model.heading_rad == pytest.approx(heading, abs=1e-6)
    np.testing.assert_allclose(model.travel_mm(SECTOR_RAD), travel_at(SECTOR_RAD), atol=1e-6)
    assert model.sigma_mm < 1e-6


def test_the_spread_of_a_touch_is_found_and_its_error_stated() -> None:
    rng = np.random.default_rng(3)
    angle = np.tile(SECTOR_RAD, 3)
    spread, off = [], []
    for _ in range(40):
        noise = rng.normal(0.0, 0.03, len(angle))
        model = fit_travel(angle, excess_at(angle, 0.3) + noise)
        stated = model.systematic_mm2(np.array([0.4]), np.eye(1))[0, 0]
        reach = model.reach_mm(np.array([0.4]), math.inf) - hexagon_reach_mm(FLATS_MM, 0.4 - 0.3)
        spread.append(model.sigma_mm)
        wrong = model.travel_mm(np.array([0.4])) - reach - travel_at(np.array([0.4]))
        off.append(float(wrong[0]) / math.sqrt(stated))
    assert np.mean(spread) == pytest.approx(0.03, rel=0.1)
    assert 0.6 < np.std(off) < 1.8


@pytest.mark.parametrize("directions", [4, 12])
def test_the_spread_of_a_touch_by_direction_is_found(directions: int) -> None:
    rng = np.random.default_rng(2)
    angle = np.repeat(np.arange(directions) * (2.0 * math.pi / directions), 400)
    along, across = 0.02, 0.06
    true = np.hypot(along * np.cos(angle), across * np.sin(angle))
    found = fit_travel(angle, rng.normal(0.0, true))
    here = np.array([0.0, math.pi / 2, math.pi])
    np.testing.assert_allclose(found.sigma_at_mm(here), [along, across, along], rtol=0.1)
    assert found.sigma_mm == pytest.approx(math.sqrt((along**2 + across**2) / 2.0), rel=0.05)


HEADING_RAD = math.pi / 3 * 30 / 120

# Errors of 30 touches of a flat wall by the default detector on the twin (simulated, seed 1001,
# preset typical), without the arm's repeatability, um.
MEASURED_UM = (
    3, -3, 18, 2, 7, -7, -3, 49, -3, -4, 33, 7, -33, 13, -21, -26, 1, -44, 11, 23, -16, -9, 2, -6,
    -8, 13, -1, 13, -8, -1,
)  # fmt: skip
REPEATABILITY_MM = 0.028


def touched(prober: IdealProber, start: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, ...]:
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    return np.array([prober.touch(start, unit).reading_mm for unit in direction]), direction


@pytest.mark.parametrize(("contacts", "trials"), [(4, 350), (12, 150)])
def test_no_divergence_and_honest_regions_with_measured_errors(contacts: int, trials: int) -> None:
    """Five hundred holes, errors resampled from measured ones, calibration by measured touches."""
    rng = np.random.default_rng(1000 + contacts)
    covered, error = 0, []
    sector = np.tile(SECTOR_RAD, 3)
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
        hole = estimate_hole(reading, direction, start, travel)
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
    travel = TravelModel.of(0.12)
    known = replace(travel, sigma_mm=0.03, heading_rad=HEADING_RAD)
    hole = estimate_hole(reading, direction, np.zeros(2), known)
    plain_mm = 2.0 / 12.0 * 0.3  # where every contact has the same weight
    assert np.linalg.norm(hole.center_mm) < 0.4 * plain_mm


def _errors(rng: np.random.Generator, count: int) -> np.ndarray:
    measured = rng.choice(np.array(MEASURED_UM) / 1000.0, count)
    return measured + rng.normal(0.0, REPEATABILITY_MM, count)
