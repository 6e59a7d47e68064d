"""How many events a px of motion makes, and that the rendering's steps do not matter."""

import math

import pytest

from stand_ins.camera_stage import CENTERS, RADIUS_PX, camera, film, strokes


def events_per_px(name: str, contrast: float, speed_px_s: float) -> float:
    travel_px = 56.0
    events = film(camera(name, contrast), strokes(speed_px_s, travel_px))
    return len(events) / len(CENTERS) / travel_px


@pytest.mark.parametrize("name", ["clean", "typical", "noisy"])
@pytest.mark.parametrize("contrast", [4.0, 6.0, 8.0, 12.5])
def test_a_px_of_slow_motion_makes_the_events_that_the_contrast_pays_for(name, contrast):
    crossings = math.log(contrast) / 0.25
    per_crossing = 2 * 2 * RADIUS_PX
    measured = events_per_px(name, contrast, 40.0)
    assert 0.95 * per_crossing * (crossings - 1) < measured
    assert measured < 1.05 * per_crossing * (crossings - 0.5)


def test_events_fall_with_speed_as_bandwidth_and_dead_time_demand():
    clean = [events_per_px("clean", 6.0, speed) for speed in (40.0, 3000.0)]
    assert clean[1] == pytest.approx(clean[0], rel=0.05)
    typical, noisy = (
        [events_per_px(name, 6.0, speed) for speed in (40.0, 1000.0, 3000.0)]
        for name in ("typical", "noisy")
    )
    assert typical[0] > 1.1 * typical[1] > 1.1**2 * typical[2]
    assert noisy[1] < 0.95 * typical[1]
    assert noisy[2] < 0.8 * typical[2]
    fast = strokes(1000.0, 56.0)
    dead = len(film(camera(refractory_us=500.0), fast))
    alive = len(film(camera(refractory_us=0.0), fast))
    assert dead < 0.9 * alive
