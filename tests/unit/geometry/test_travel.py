"""Trigger travel by direction and the bit's heading, from touches on flat walls."""

import math

import numpy as np
import pytest

from spikingtac.geometry.hole import hexagon_reach_mm
from spikingtac.geometry.travel import (
    fit_travel,
    hexagon_reach_in_hole_mm,
)
from spikingtac.sim.rig.walls import HexBit

FLATS_MM = 0.75
SECTOR_RAD = np.radians([0, 25, 50, -25, -50, 180, 155, 130, 205, 230])


def travel_at(angle: np.ndarray) -> np.ndarray:
    return 0.15 - 0.01 * np.cos(angle) + 0.02 * np.sin(angle) - 0.05 * np.cos(2 * angle)


def excess_at(angle: np.ndarray, heading: float) -> np.ndarray:
    return travel_at(angle) - hexagon_reach_mm(FLATS_MM, angle - heading)


@pytest.mark.parametrize("radius_mm", [0.7, 1.2, 5.0])
def test_the_reach_in_a_hole_is_where_the_corners_meet_it(radius_mm: float) -> None:
    corner = HexBit(across_flats_mm=FLATS_MM).points_mm[:, :2]
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
