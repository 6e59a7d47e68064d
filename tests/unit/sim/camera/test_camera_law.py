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
