"""How many events a px of motion makes, and that the rendering's steps do not matter."""

import math
from dataclasses import replace

import numpy as np
import pytest

from spikingtac.sim.camera.camera import EventCamera
from spikingtac.sim.camera.config import BackgroundConfig, StepConfig, load_camera
from spikingtac.types import EventPacket
from stand_ins.camera_stage import CENTERS, RADIUS_PX, SIZE, camera, film, strokes


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


def test_both_polarities_balance_over_to_and_fro():
    for name in ("clean", "typical", "noisy"):
        on_share = film(camera(name), strokes(40.0, 56.0)).p.mean()
        assert abs(on_share - 0.5) < 0.03


@pytest.mark.parametrize(("speed_px_s", "tolerance_px"), [(40.0, 0.005), (1000.0, 0.05)])
def test_the_steps_are_fine_enough(speed_px_s, tolerance_px):
    """Ten times finer steps change neither the number of events nor, by much, their times."""
    images = strokes(speed_px_s, 12.0)
    coarse, fine = (
        EventCamera(replace(load_camera("typical"), size=SIZE, background=BackgroundConfig(),
                            pixel=replace(load_camera("typical").pixel, leak_hz=0.0, jitter_us=0.0),
                            steps=steps), seed=1)
        for steps in (StepConfig(), StepConfig(motion_px=0.01, min_us=1.0, max_us=100.0))
    )  # fmt: skip
    one, two = film(coarse, images), film(fine, images)
    assert len(one) == pytest.approx(len(two), rel=0.003)
    matched = matched_delays_us(one, two)
    assert len(matched) > 0.9 * len(two)
    assert np.sqrt(np.mean(matched**2.0)) * speed_px_s * 1e-6 < tolerance_px


def matched_delays_us(one: EventPacket, two: EventPacket) -> np.ndarray:
    """Return the time differences in the pixels that fired the same polarities in both."""

    def by_pixel(packet: EventPacket) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        pixel = packet.y.astype(np.int64) * 128 + packet.x
        return {int(i): (packet.t[pixel == i], packet.p[pixel == i]) for i in np.unique(pixel)}

    first, second = by_pixel(one), by_pixel(two)
    same = [i for i in first if i in second and np.array_equal(first[i][1], second[i][1])]
    return np.concatenate([first[i][0] - second[i][0] for i in same])
