import math

import numpy as np
import pytest

from spikingtac.sim.indenters import IndenterConfig
from spikingtac.sim.motions import MotionConfig, SegmentConfig
from spikingtac.sim.scene import ContactConfig, Scene, VariationConfig
from spikingtac.sim.timeline import Timeline, vary

WIDE = VariationConfig(
    place_mm=1.0,
    heading_deg=180.0,
    yaw_deg=20.0,
    depth_fraction=0.3,
    extent_fraction=0.3,
    speed_fraction=0.3,
    pause_s=0.5,
)
MOTION = MotionConfig(
    height_mm=0.3,
    segments=(
        SegmentConfig(kind="press", depth_mm=0.5, duration_s=0.2),
        SegmentConfig(kind="slide", dx_mm=1.0, dy_mm=0.5, duration_s=0.3),
        SegmentConfig(kind="circle", radius_mm=0.4, turns=1.0, duration_s=0.3),
        SegmentConfig(kind="roll", radius_mm=7.0, dx_mm=1.0, duration_s=0.2),
        SegmentConfig(kind="lift", height_mm=0.3, duration_s=0.2),
    ),
)


def scene(repeats: int = 2, variation: VariationConfig | None = None) -> Scene:
    contact = ContactConfig(
        indenter=IndenterConfig(kind="ball"), motion=MOTION, repeats=repeats, pause_s=0.4
    )
    return Scene(contacts=(contact,), variation=variation or VariationConfig())


def path(timeline: Timeline, until_s: float) -> list[float | None]:
    times = np.arange(0.0, until_s, 0.01)
    bodies = [timeline.at(float(t)) for t in times]
    return [None if body is None else float(body[1].position_mm.sum()) for body in bodies]


def test_a_shorter_scene_is_the_beginning_of_the_longer_one():
    full = path(Timeline(scene(variation=WIDE), seed=5), 2.0)
    assert path(Timeline(scene(variation=WIDE), seed=5, duration_s=1.0), 1.0) == full[:100]


def test_a_longer_scene_repeats_whole_contacts_varied_anew_and_ends_quiet():
    own = Timeline(scene(variation=WIDE), seed=5).duration_s
    long = path(Timeline(scene(variation=WIDE), seed=5, duration_s=3 * own), 3 * own)
    starts = np.flatnonzero(np.diff(np.array([body is not None for body in long], int)) == 1)
    assert len(starts) >= 4
    assert all(body is None for body in long[-100:])
    assert long[starts[0] + 5] != long[starts[2] + 5]


def test_variation_stays_within_its_bounds():
    for seed in range(50):
        varied = vary(MOTION, WIDE, np.random.default_rng(seed))
        press, slide, circle, roll, lift = varied.segments
        assert abs(varied.x_mm) <= 1.0
        assert abs(varied.yaw_deg) <= 20.0
        assert 0.35 <= press.depth_mm <= 0.65
        assert 0.2 / 1.3 <= press.duration_s <= 0.2 / 0.7
        length = math.hypot(slide.dx_mm, slide.dy_mm)
        assert 0.7 <= length / math.hypot(1.0, 0.5) <= 1.3
        assert circle.radius_mm / 0.4 == pytest.approx(length / math.hypot(1.0, 0.5))
        assert roll.radius_mm == 7.0  # the body's, not the path's
        assert lift.height_mm == 0.3
