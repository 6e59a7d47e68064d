"""Motions: profiles, speeds, and where each segment leads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.schema import build
from spikingtac.sim.motions import (
    IndenterMotion,
    MotionConfig,
)


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
        ({"kind": "slide", "speed_deg_s": 1.0}, "speed_deg_s has no meaning"),
        ({"kind": "slide", "dx_mm": 1.0, "speed_mm_s": -1.0}, "speed_mm_s is -1, valid are"),
        ({"kind": "slide", "dxmm": 1.0, "duration_s": 1.0}, "did you mean 'dx_mm'"),
    ],
)
def test_a_wrong_segment_is_named(segment: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        motion(segment)
