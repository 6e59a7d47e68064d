"""Scenes: files, motions, variation by the seed, and the thread that works ahead."""

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.errors import ConfigError, SettingsFileError
from spikingtac.schema import build
from spikingtac.sim.catalog import load_scene
from spikingtac.sim.indenters import IndenterConfig
from spikingtac.sim.motions import IndenterMotion, MotionConfig, SegmentConfig
from spikingtac.sim.scene import ContactConfig, Scene, VariationConfig
from spikingtac.sim.source import prefetch
from spikingtac.sim.timeline import Timeline, vary

CONTACT = """
[[contacts]]
indenter = { kind = "ball" }
[contacts.motion]
height_mm = 0.3
segments = [
  { kind = "press", depth_mm = 0.5, duration_s = 0.1 },
  { kind = "lift", duration_s = 0.1 },
]
"""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("lead_in = 1.0", r"unknown key 'lead_in'; did you mean 'lead_in_s'\?"),
        ("[camera.settings.light]\ncontrst = 3.0", "did you mean 'contrast'"),
        ("[history]\nreferences = 'new'", "valid: rested, random, fresh"),
        ("[optics.discs]\nmissing = [64]", "marker 64 does not exist, valid are 0 to 63"),
        ("[skin]\ngrid = [100000, 100000]", "valid are 1 to 10000 markers"),
        ("[gel.grid]\ncells = 1000000000", "cells is 1e[+]09, valid are 8 to 512"),
        ("[optics]\nsize = [100000, 100000]\nk1 = 0.0", "valid are 1 to 2097152 pixels in all"),
        (CONTACT.replace("]]\n", "]]\nrepeats = 1000000000\n"), "valid are 1 to 10000"),
        ("lead_in_s = 1e15", "lead_in_s is 1e[+]15, valid are 0 to 10000"),
        ("lead_in_s = 1" + "0" * 5000, "not valid TOML"),
        ("about = " + "[" * 100_000 + "]" * 100_000, "nested deeper than 32"),
        (".".join("a" * 100_000) + " = 1", "nested deeper than 32"),
        ("about = '" + "x" * (1 << 20) + "'", "longer than 1048576 bytes"),
        (CONTACT.replace("ball", "bal"), r"unknown indenter 'bal'; did you mean 'ball'\?"),
        (CONTACT.replace('"lift"', '"hold"'), "end above it"),
        (CONTACT.replace("height_mm = 0.3", "height_mm = -0.1"), "must start above the skin"),
    ],
)
def test_a_wrong_file_names_the_key_and_what_is_valid(tmp_path: Path, text: str, expected: str):
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    with pytest.raises(SettingsFileError, match=expected):
        load_scene(tmp_path / "scene.toml")


def motion(*segments: dict[str, Any], **start: float) -> IndenterMotion:
    return IndenterMotion(build(MotionConfig, {**start, "segments": list(segments)}, "motion"))


@pytest.mark.parametrize("name", ["minimum_jerk", "trapezoid"])
@pytest.mark.parametrize(
    "segment",
    [
        {"kind": "slide", "dx_mm": 3.0, "dy_mm": -4.0},
        {"kind": "rub", "dx_mm": 2.0, "repeats": 3},
        {"kind": "circle", "radius_mm": 2.0, "turns": -1.5, "heading_deg": 30.0},
        {"kind": "roll", "dy_mm": 3.0, "radius_mm": 7.0},
        {"kind": "press", "depth_mm": 0.5},
        {"kind": "lift", "height_mm": 2.0},
    ],
)
def test_the_stated_speed_is_the_peak_speed(segment: dict[str, Any], name: str) -> None:
    path = motion({**segment, "speed_mm_s": 40.0, "profile": name})
    times = np.linspace(0.0, path.duration_s, 6001)
    places = np.array([path.pose(float(t)).position_mm for t in times])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
    assert speeds.max() == pytest.approx(40.0, rel=0.01)


def test_rolling_leaves_the_touching_point_at_rest() -> None:
    path = motion({"kind": "roll", "dx_mm": 3.0, "dy_mm": 1.0, "radius_mm": 4.0, "duration_s": 1.0})
    first, then = path.pose(0.5), path.pose(0.5 + 1e-6)
    touching = np.array([0.0, 0.0, 4.0])  # from the body's centre, towards the skin
    turned = then.rotation @ first.rotation.T @ touching - touching
    moved = then.position_mm - first.position_mm + turned
    assert np.linalg.norm(moved) < 1e-6 * np.linalg.norm(then.position_mm - first.position_mm)


@pytest.mark.parametrize(
    ("segment", "message"),
    [
        ({"kind": "pres", "depth_mm": 1.0, "duration_s": 1.0}, "did you mean 'press'"),
        ({"kind": "press", "duration_s": 1.0}, "needs depth_mm"),
        ({"kind": "hold"}, "needs one of duration_s and a speed"),
        ({"kind": "hold", "speed_mm_s": 1.0}, "speed_mm_s has no meaning"),
        ({"kind": "hold", "duration_s": 1.0, "dx_mm": 1.0}, "dx_mm has no meaning for 'hold'"),
        ({"kind": "slide", "duration_s": 1.0, "speed_mm_s": 1.0}, "one of duration_s"),
        ({"kind": "slide", "dx_mm": 1.0, "speed_mm_s": -1.0}, "speed_mm_s is -1, valid are"),
    ],
)
def test_a_wrong_segment_is_named(segment: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        motion(segment)


FRACTIONS = dict.fromkeys(("depth_fraction", "extent_fraction", "speed_fraction"), 0.3)
WIDE = VariationConfig(place_mm=1.0, heading_deg=180.0, yaw_deg=20.0, pause_s=0.5, **FRACTIONS)
SEGMENTS = (
    SegmentConfig(kind="press", depth_mm=0.5, duration_s=0.2),
    SegmentConfig(kind="slide", dx_mm=1.0, dy_mm=0.5, duration_s=0.3),
    SegmentConfig(kind="circle", radius_mm=0.4, turns=1.0, duration_s=0.3),
    SegmentConfig(kind="roll", radius_mm=7.0, dx_mm=1.0, duration_s=0.2),
    SegmentConfig(kind="lift", height_mm=0.3, duration_s=0.2),
)
MOTION = MotionConfig(height_mm=0.3, segments=SEGMENTS)
BALL = IndenterConfig(kind="ball")
CONTACTS = (ContactConfig(indenter=BALL, motion=MOTION, repeats=2, pause_s=0.4),)
VARIED = Scene(contacts=CONTACTS, variation=WIDE)


def path(timeline: Timeline, until_s: float) -> list[float | None]:
    times = np.arange(0.0, until_s, 0.01)
    bodies = [timeline.at(float(t)) for t in times]
    return [None if body is None else float(body[1].position_mm.sum()) for body in bodies]


def test_a_shorter_scene_is_the_beginning_of_the_longer_one():
    full = path(Timeline(VARIED, seed=5), 2.0)
    assert path(Timeline(VARIED, seed=5, duration_s=1.0), 1.0) == full[:100]


def test_a_longer_scene_repeats_whole_contacts_varied_anew_and_ends_quiet():
    own = Timeline(VARIED, seed=5).duration_s
    long = path(Timeline(VARIED, seed=5, duration_s=3 * own), 3 * own)
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


def test_an_error_comes_in_its_place():
    stream = prefetch((1 // number for number in (1, 0)), 8)
    assert next(stream) == 1
    with pytest.raises(ZeroDivisionError):
        next(stream)


def test_leaving_early_ends_the_thread():
    numbers = itertools.count()
    stream = prefetch(numbers, 4)
    assert next(stream) == 0
    stream.close()
    ended_at = next(numbers)
    assert ended_at <= 8
    assert next(numbers) == ended_at + 1, "nobody takes more"
