"""Plain twins of the kernels for small motions. No scheduled pixel may miss an event."""

import math

import numpy as np
import pytest

from spikingtac.sim.camera.config import CameraConfig, LightConfig, PixelConfig
from spikingtac.sim.camera.pixels import KEY_SHIFT
from spikingtac.sim.camera.sensor import make_sensor, settle_sensor
from spikingtac_paper.free_motion.small_motion import (
    EDGE_DTYPE,
    EdgePixels,
    edge_distance_kernel,
    edge_level_kernel,
    make_timing_wheel,
    small_motion_kernel,
)

STEP_US = 1000.0


def sensor_of(count: int):
    pixel = PixelConfig(mismatch=0.03, leak_hz=2.0, refractory_us=50.0)
    config = CameraConfig(light=LightConfig(blur_px=0.9), pixel=pixel)
    sensor = make_sensor(config, (count, 1), np.random.default_rng(0))
    settle_sensor(sensor, np.zeros((1, count), np.float32), 0.0, "random", np.random.default_rng(1))
    return sensor


def rims_of(count: int, rng: np.random.Generator) -> EdgePixels:
    edges = np.zeros(count, EDGE_DTYPE)
    edges["inside_px"] = rng.uniform(-3.0, 3.0, count)
    edges["lowest_level"], edges["highest_level"] = -10.0, 10.0
    edges["slope"] = rng.normal(size=(count, 6))
    record = np.arange(count, dtype=np.int32)
    record[::5] = -1
    return EdgePixels(edges, record)


def plain_events(
    sensor, edge_pixels: EdgePixels, motion: np.ndarray
) -> dict[int, list[tuple[int, int]]]:
    """Visit every pixel in every step."""
    chip = sensor.chip[0]
    every: dict[int, list[tuple[int, int]]] = {}
    for index, px in enumerate(sensor.pixels[0]):
        gap, level, dead_us = float(px["difference"]), float(px["level"]), -1.0
        out = every.setdefault(index, [])
        for step in range(1, motion.shape[2]):
            record, at_us = edge_pixels.record[index], (step - 1) * STEP_US
            target = level
            if record >= 0:
                target = edge_level_kernel(
                    px, chip, edge_distance_kernel(edge_pixels.edges[record], motion, step)
                )
            slope = (target - level) / STEP_US + px["leak_per_us"]
            end_us = at_us + STEP_US
            while at_us < end_us:
                if dead_us > at_us:
                    at_us, gap = min(dead_us, end_us), 0.0
                    continue
                limit = px["threshold_on"] if slope > 0 else -px["threshold_off"]
                wait = max((limit - gap) / slope, 0.0) if slope != 0.0 else math.inf
                if at_us + wait > end_us:
                    gap += slope * (end_us - at_us)
                    break
                at_us += wait
                out.append((round(at_us), int(slope > 0)))
                dead_us = at_us + chip["refractory_us"]
            level = target
    return every


def test_sway_equals_visiting_every_pixel_in_every_step() -> None:
    rng = np.random.default_rng(4)
    count, steps = 120, 400
    edge_pixels = rims_of(count, rng)
    swing = 0.4 * np.sin(np.arange(steps + 1) * rng.uniform(0.05, 0.2, (2, 6, 1)))
    motion = swing.astype(np.float32)
    plain_sensor, sensor = sensor_of(count), sensor_of(count)
    for one in (plain_sensor, sensor):
        one.chip["leak_jitter"] = 0.0
        for index, record in enumerate(edge_pixels.record):
            px = one.pixels[0, index]
            if record >= 0:
                px["level"] = edge_level_kernel(
                    px, one.chip[0], edge_pixels.edges[record]["inside_px"]
                )
            px["previous_intensity"] = px["intensity"] = 1.0
    out = np.zeros(1 << 14, np.int64)
    flat = sensor.pixels.reshape(-1)
    wheel = make_timing_wheel(count, 64)
    for first in range(0, steps, 100):
        part = np.ascontiguousarray(motion[..., first : first + 101])
        small_motion_kernel(
            flat, edge_pixels, sensor.chip[0], wheel, part, first * STEP_US, STEP_US, out
        )
    keys = out[1 : 1 + out[0]]
    plain = plain_events(plain_sensor, edge_pixels, motion)
    assert out[0] > 500
    for index in range(count):
        own = np.sort(keys[(keys & ((1 << KEY_SHIFT) - 1)) >> 1 == index])
        found = [(int(key >> KEY_SHIFT), int(key & 1)) for key in own]
        assert len(found) == len(plain[index])
        for (t_us, on), (plain_us, plain_on) in zip(found, plain[index], strict=True):
            assert on == plain_on
            assert t_us == pytest.approx(plain_us, abs=5)
