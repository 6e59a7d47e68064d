"""The published and the adaptive search, on a bit and a hole without dynamics."""

import math
from dataclasses import replace

import numpy as np
import pytest

from spikingtac.errors import ConfigError, SearchError
from spikingtac.geometry.travel import TravelModel
from spikingtac.robot.adaptive_search import probe_hole
from spikingtac_paper.holes.cross_search import calibrated_circle, cross_search, published_circle
from spikingtac_paper.holes.scoring import REGION
from stand_ins.touching import IdealProber

CENTER_MM = (0.3, -0.2)


def travel(heading: float | None = 0.3, sigma_mm: float = 0.03) -> TravelModel:
    flat = TravelModel.of(0.12)
    return replace(flat, sigma_mm=sigma_mm, heading_rad=heading)


def test_the_cross_touches_as_published() -> None:
    prober = IdealProber(2.0, center_mm=CENTER_MM)
    touches = cross_search(prober, np.array([0.6, 0.4]), travel())
    np.testing.assert_allclose(
        [touch.direction for touch in touches], [[1, 0], [-1, 0], [0, 1], [0, -1]], atol=1e-12
    )
    np.testing.assert_allclose(prober.starts[0], [0.6, 0.4])
    middle = (touches[0].reading_mm[0] + touches[1].reading_mm[0]) / 2.0
    np.testing.assert_allclose(prober.starts[2:], [[middle, 0.4]] * 2)


def test_published_and_calibrated_formulas() -> None:
    """Head-on, a round probe of the paper's constants would be exact; the hexagon is not."""
    prober = IdealProber(2.0, travel_mm=0.4)
    mean = TravelModel.of(0.4)
    touches = cross_search(prober, np.zeros(2), mean)
    printed = published_circle(touches, 0.03)
    measured = np.mean([np.linalg.norm(touch.reading_mm) for touch in touches])
    assert printed.radius_mm == pytest.approx(float(measured) + 0.375 - 0.4, abs=1e-3)
    assert calibrated_circle(touches, mean).radius_mm == pytest.approx(2.0, abs=0.03)
    np.testing.assert_allclose(calibrated_circle(touches, mean).center_mm, 0.0, atol=0.03)


@pytest.mark.parametrize("radius_mm", [0.7, 2.0, 5.0])
def test_the_adaptive_search_is_exact_without_noise(radius_mm: float) -> None:
    prober = IdealProber(radius_mm, center_mm=CENTER_MM)
    far = 0.8 * (radius_mm - 0.433) * np.array([math.cos(0.5), math.sin(0.5)])
    found = probe_hole(prober, travel(), np.array(CENTER_MM) + far, contacts=8)
    assert len(found.touches) == 8
    np.testing.assert_allclose(found.circle.center_mm, CENTER_MM, atol=3e-3)
    assert found.circle.radius_mm == pytest.approx(radius_mm, abs=3e-3)


def test_no_room_and_too_few_contacts_are_refused() -> None:
    jammed = IdealProber(0.434, travel_mm=0.0, heading_rad=0.0)
    with pytest.raises(ConfigError, match="contacts is 2, it must be at least 3"):
        probe_hole(jammed, travel(), np.zeros(2), contacts=2)
    for run in (
        lambda: cross_search(jammed, np.zeros(2), travel()),
        lambda: probe_hole(jammed, travel(), np.zeros(2)),
    ):
        with pytest.raises(SearchError, match="on the rim or is"):
            run()


@pytest.mark.parametrize(("false", "touches"), [(4, 7), (0, 11), (2, 11)])
def test_one_false_contact_is_touched_again(false: int, touches: int) -> None:
    # Which one of the first three is false is not known: all are touched again.
    prober = IdealProber(2.0, noise_mm=[0.0] * false + [-1.2])
    found = probe_hole(prober, travel(), np.zeros(2), contacts=6)
    assert (len(found.touches), len(prober.starts)) == (6, touches)
    np.testing.assert_allclose(found.circle.center_mm, 0.0, atol=3e-3)


def test_the_calibrated_cross_states_an_honest_region() -> None:
    """From starts off the middle the first chord is oblique: its contacts tell less and slide."""
    rng = np.random.default_rng(5)
    sigma_mm, inside = 0.03, []
    model = travel(heading=None, sigma_mm=sigma_mm)
    for _ in range(200):
        radius = float(rng.uniform(0.7, 5.0))
        away = 0.9 * (radius - 0.433) * math.sqrt(rng.uniform())
        turn = rng.uniform(0.0, 2.0 * math.pi)
        heading, noise_mm = rng.uniform(0.0, math.pi / 3), rng.normal(0.0, sigma_mm, 4).tolist()
        prober = IdealProber(radius, heading_rad=heading, noise_mm=noise_mm)
        touches = cross_search(prober, away * np.array([math.cos(turn), math.sin(turn)]), model)
        circle = calibrated_circle(touches, model)
        error = np.append(circle.center_mm, circle.radius_mm - radius)
        inside.append(error @ np.linalg.solve(circle.covariance_mm2, error) < REGION)
    assert 0.90 <= np.mean(inside) <= 0.99
