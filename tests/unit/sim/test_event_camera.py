"""The simulated event camera: bytes, rates, laws of events, random numbers, readout, presets."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from spikingtac.sim.camera import event_camera
from spikingtac.sim.camera.config import (
    CAMERA_NAMES,
    CameraConfig,
    PixelConfig,
    ReadoutConfig,
    load_camera,
)
from spikingtac.sim.camera.coverage import coverage_image_kernel
from spikingtac.sim.camera.event_camera import EventCamera
from spikingtac.sim.camera.pixels import (
    KEY_SHIFT,
    advance_light_ramp_kernel,
    emit_crossings_kernel,
    intensity_kernel,
    uniform_kernel,
)
from spikingtac.sim.camera.readout import BACKLOG_US, Arbiter, Readout, arbitrate_kernel
from spikingtac.sim.camera.sweep import interpolate_disc_kernel
from spikingtac.types import EventPacket
from stand_ins.camera_stage import CENTERS, PERIOD_US, RADIUS_PX, SIZE, camera, film, image, strokes
from stand_ins.random_packets import assert_equal


@pytest.mark.parametrize("name", ["clean", "typical", "noisy"])
def test_any_cutting_at_the_same_images_gives_the_same_bytes(name):
    config = replace(load_camera(name), readout=ReadoutConfig(cap_mev_s=1.0, loss=0.3))
    images = strokes(900.0, 60.0)
    whole = film(EventCamera(config, SIZE, seed=3), images)
    sensor = EventCamera(config, SIZE, seed=3)
    sensor.settle(images[0], "random")
    parts, rng, at = [], np.random.default_rng(0), 0
    while at < len(images) - 1:
        stop = min(at + int(rng.integers(1, 6)), len(images) - 1)
        parts.append(sensor.advance(images[at : stop + 1]))  # the shared end is passed over
        at = stop
    assert_equal(EventPacket.concatenate(parts), whole)


def test_equal_seeds_are_equal_to_the_byte_and_copies_go_on_alone():
    images = strokes(200.0, 20.0)
    config = load_camera("typical")
    first, again, other = (EventCamera(config, SIZE, seed) for seed in (7, 7, 8))
    one, same = film(first, images), film(again, images)
    assert_equal(same, one)
    assert film(other, images).t.tolist() != one.t.tolist()
    twin = copy.deepcopy(again)
    later = [replace(item, t_us=item.t_us + images[-1].t_us) for item in images[1:]]
    assert_equal(twin.advance(later), again.advance(later))


@pytest.mark.parametrize(
    ("name", "leak_hz", "noise_hz"), [("typical", 0.07, 0.1), ("noisy", 0.2, 1.0)]
)
def test_a_still_scene_makes_the_set_rates(name, leak_hz, noise_hz):
    preset = load_camera(name)
    quiet = replace(preset, background=replace(preset.background, hot_fraction=0.0))
    span_us, pixels = 2_000_000, 320 * 320
    still = [image(t) for t in range(0, span_us + 1, 100_000)]
    packet = film(EventCamera(quiet, (320, 320), seed=5), still, "rested")
    assert len(packet) / pixels / 2 == pytest.approx(leak_hz + noise_hz, rel=0.05)
    on, off = packet.p.sum(), (~packet.p).sum()
    assert off / pixels / 2 == pytest.approx(noise_hz / 2, rel=0.05)
    assert (on - off) / pixels / 2 == pytest.approx(leak_hz, rel=0.05)
    halves = np.histogram(packet.t, 2, (0, span_us))[0]
    assert halves[0] == pytest.approx(halves[1], rel=0.05)


def test_missing_markers_make_nothing_and_broken_ones_less():
    images = [image(k * PERIOD_US, (0.1 * k, 0.0)) for k in range(60)]
    whole = film(camera(), images, "fresh")
    gone = [replace(item, radius_px=np.array([7.0, 0.0, 7.0, 7.0])) for item in images]
    missing = film(camera(), gone, "fresh")
    near_second = np.hypot(whole.x - 83.0, whole.y - 40.4) < 20
    assert_equal(missing, whole.select(~near_second))
    cut = np.tile([0.0, 1.0, np.inf], (4, 1))
    cut[0, 2] = 0.0  # the lower half is gone
    broken = film(camera(), [replace(item, chord=cut) for item in images], "fresh")
    lower = (broken.x < 64) & (broken.y > 42.5) & (broken.y < 64)
    assert not lower.any()
    near_first = np.hypot(whole.x - 43.0, whole.y - 40.1) < 20
    fraction = (np.hypot(broken.x - 43.0, broken.y - 40.1) < 20).sum() / near_first.sum()
    assert 0.4 < fraction < 0.6


SMALL = (64, 64)
TYPICAL = PixelConfig(mismatch=0.03, bandwidth_hz=2000.0, refractory_us=50.0, latency_us=150.0)


@njit
def plain_sweep(sensor, sweep, _limits, out):
    """Update every pixel in equal steps: nothing is skipped or carried forward."""
    (height, width), steps, chip = sensor.pixels.shape, 20, sensor.chip[0]
    covered, span_us = np.empty((height, width), np.float32), (sweep.end_us - sweep.start_us) / 20
    for step in range(steps):
        start_us, end_us = sweep.start_us + step * span_us, sweep.start_us + (step + 1) * span_us
        for k in range(len(sweep.now)):
            interpolate_disc_kernel(sweep.before[k], sweep.after[k], (step + 1) / 20, sweep.now[k])
        coverage_image_kernel(sweep.now, chip, covered)
        for y in range(height):
            for x in range(width):
                px = sensor.pixels[y, x]
                light = intensity_kernel(px, covered[y, x])
                rise = advance_light_ramp_kernel(px, chip, light, end_us, span_us)
                emit_crossings_kernel(px, chip, out, start_us, span_us, rise)
    for k in range(len(sweep.now)):
        sweep.before[k] = sweep.after[k]


@pytest.mark.parametrize("speed_px_s", [20.0, 300.0])
def test_every_pixel_at_every_step_gives_what_the_edges_alone_give(speed_px_s, monkeypatch):
    monkeypatch.setattr(event_camera, "MAX_STEP_US", 200.0)
    config = CameraConfig(pixel=TYPICAL)
    one_disc, times_us = np.array([[24.3, 30.2]]), range(0, 60_001, PERIOD_US)
    shots = [image(t_us, [speed_px_s * t_us * 1e-6] * 2, one_disc) for t_us in times_us]
    one = film(EventCamera(config, SMALL, seed=2), shots)
    monkeypatch.setattr(event_camera.sweep, "sweep_kernel", plain_sweep)
    two = film(EventCamera(config, SMALL, seed=2), shots)
    assert len(one) == pytest.approx(len(two), rel=0.005)
    places = [(packet.y * 64 + packet.x) * 2 + packet.p for packet in (one, two)]
    counts = [np.bincount(place.astype(int), minlength=64 * 64 * 2) for place in places]
    assert np.abs(counts[0] - counts[1]).sum() <= 0.01 * len(one)
    shared = min(len(one), len(two))
    assert np.median(np.abs(one.t[:shared] - two.t[:shared])) < 100


@pytest.mark.parametrize("name", ["clean", "typical", "noisy"])
@pytest.mark.parametrize("contrast", [4.0, 6.0, 8.0, 12.5])
def test_a_px_of_slow_motion_makes_the_events_that_the_contrast_pays_for(name, contrast):
    crossings = math.log(contrast) / 0.25
    per_crossing, travel_px = 2 * 2 * RADIUS_PX, 56.0
    events = film(camera(name, contrast), strokes(40.0, travel_px))
    measured = len(events) / len(CENTERS) / travel_px
    assert 0.95 * per_crossing * (crossings - 1) < measured
    assert measured < 1.05 * per_crossing * (crossings - 0.5)


KEY = np.uint64(0x1234_5678_9ABC_DEF1)


def splitmix(key: int, counter: int) -> float:
    """Plain Python, where integers never overflow: the reference of Steele, Lea and Flood."""
    mask = (1 << 64) - 1
    z = (key + counter * 0x9E3779B97F4A7C15) & mask
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    z ^= z >> 31
    return ((z >> 11) + 0.5) / (1 << 53)


def test_equals_the_published_generator():
    drawn = [uniform_kernel(KEY, np.uint64(k)) for k in range(100)]
    assert drawn == [splitmix(int(KEY), k) for k in range(100)]


READOUT_SIZE = (64, 48)


def random_keys(count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    limits = 1_000, READOUT_SIZE[0], READOUT_SIZE[1], 2
    t_us, x, y, on = (rng.integers(0, limit, count) for limit in limits)
    return (t_us << KEY_SHIFT) | ((y * READOUT_SIZE[0] + x) << 1) | on


def served(events, event_us):
    """Plain Python server: one event at a time, in order."""
    out, dropped, free = [], 0, -np.inf
    for key in events.tolist():
        t, code = key >> KEY_SHIFT, key & ((1 << KEY_SHIFT) - 1)
        start = max(float(t), free)
        if start - t > BACKLOG_US:
            dropped += 1
            continue
        free = start + event_us
        out.append((int(start) << KEY_SHIFT) | code)
    return out, dropped


@pytest.mark.parametrize("event_us", [0.1, 0.5, 3.0])
@pytest.mark.parametrize("count", [0, 1, 2000])
def test_the_arbiter_equals_its_plain_twin(event_us, count):
    events = np.sort(random_keys(count))
    out = np.empty(count, np.int64)
    arbiter = Arbiter(event_us, 0.0, np.full(1, -np.inf), np.zeros(1, np.uint64), np.uint64(9))
    kept, dropped, lost = arbitrate_kernel(events, arbiter, out)
    expected, expected_dropped = served(events, event_us)
    assert out[:kept].tolist() == expected
    assert (dropped, lost) == (expected_dropped, 0)
    assert (dropped > 0) == (event_us * count > 2 * BACKLOG_US)


def test_random_loss_is_as_set_and_counted():
    station = Readout(ReadoutConfig(loss=0.3), READOUT_SIZE, key=1)
    station.collect(random_keys(20_000))
    kept = len(station.release(1000))
    assert kept / 20_000 == pytest.approx(0.7, abs=0.015)
    assert station.losses["readout_loss"] == 20_000 - kept


# Contrast; threshold, mismatch, bandwidth, leak, dead time, latency, jitter; background, hot; cap.
PINNED = {
    "clean": [6.0, 0.25, 0.0, None, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, None],
    "typical": [6.0, 0.25, 0.03, 2000.0, 0.07, 50.0, 150.0, 30.0, 0.1, 1e-4, 10.0],
    "noisy": [6.0, 0.25, 0.03, 500.0, 0.2, 100.0, 150.0, 30.0, 1.0, 1e-4, 10.0],
}
OF_PIXEL = ("threshold_on", "mismatch", "bandwidth_hz", "leak_hz")
OF_TIME = ("refractory_us", "latency_us", "jitter_us")


@pytest.mark.parametrize("name", CAMERA_NAMES)
def test_the_presets_hold_the_pinned_values(name):
    camera = load_camera(name)
    pixel = [getattr(camera.pixel, field) for field in (*OF_PIXEL, *OF_TIME)]
    background = [camera.background.rate_hz, camera.background.hot_fraction]
    found = [camera.light.contrast, *pixel, *background, camera.readout.cap_mev_s]
    assert found == PINNED[name]
    assert camera.pixel.threshold_off == camera.pixel.threshold_on
    assert camera.readout.loss == 0.0
