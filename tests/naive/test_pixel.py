"""The event camera's kernels against plain programs that follow the same physics another way."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtr

from spikingtac.sim.camera.config import BackgroundConfig, CameraConfig, LightConfig, PixelConfig
from spikingtac.sim.camera.coverage import (
    SWEEP_PLAN_DTYPE,
    coverage_image_kernel,
    disc_coverage_kernel,
    discs_of,
    plan_sweep_kernel,
)
from spikingtac.sim.camera.pixels import (
    KEY_SHIFT,
    advance_constant_light_kernel,
    advance_light_ramp_kernel,
    advance_settled_kernel,
    change_below_threshold_kernel,
    emit_crossings_kernel,
    predict_leak_event_kernel,
)
from spikingtac.sim.camera.readout import background_events_kernel, make_noise, start_noise
from spikingtac.sim.camera.sensor import Sensor, make_sensor, settle_sensor
from spikingtac.sim.optics import MarkerImage

TICK_US = 0.5


@dataclass
class PlainPixel:
    """One pixel in small equal ticks: nothing is skipped, interpolated or solved in closed form."""

    pixel: PixelConfig
    leak_per_us: float
    level: float
    since_us: float = -math.inf
    events: list[tuple[float, bool]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.reference = self.level
        self.blind = False

    def tick(self, now_us: float, intensity: float) -> None:
        target = math.log(intensity)
        if self.pixel.bandwidth_hz is None:
            self.level = target
        else:
            rate = 2e-6 * math.pi * self.pixel.bandwidth_hz * intensity
            self.level += (target - self.level) * (1 - math.exp(-TICK_US * rate))
        self.reference -= self.leak_per_us * TICK_US
        if self.blind:
            if now_us - self.since_us < self.pixel.refractory_us:
                return
            self.blind, self.reference = False, self.level
        while True:
            gap = self.level - self.reference
            if -self.pixel.threshold_off < gap < self.pixel.threshold_on:
                return
            on = gap > 0
            self.events.append((now_us, on))
            self.since_us = now_us
            if self.pixel.refractory_us > 0:
                self.blind = True
                return
            self.reference += self.pixel.threshold_on if on else -self.pixel.threshold_off


def one_pixel(pixel: PixelConfig, intensity: float) -> Sensor:
    """Return a sensor of one pixel that rests at an intensity, with the mean leak and no jitter."""
    config = CameraConfig(light=LightConfig(contrast=1.0 / intensity), pixel=pixel)
    sensor = make_sensor(config, (1, 1), np.random.default_rng(0))
    sensor.pixels["mean_leak_per_us"] = sensor.pixels["threshold_on"] * pixel.leak_hz * 1e-6
    sensor.chip["leak_jitter"] = 0.0
    settle_sensor(sensor, np.zeros((1, 1), np.float32), 0.0, "fresh", np.random.default_rng(0))
    return sensor


def walk(sensor: Sensor, times_us, intensities) -> list[tuple[float, bool]]:
    """Show intensities that change evenly between the times; equal ones are left unvisited."""
    px, chip, out = sensor.pixels[0, 0], sensor.chip[0], np.zeros(4096, np.int64)
    last_us = 0.0
    for t_us, intensity in zip(times_us, intensities, strict=True):
        if abs(intensity - px["intensity"]) > 1e-6:
            if not advance_settled_kernel(px, last_us):
                advance_constant_light_kernel(px, chip, out, last_us)
            rise = advance_light_ramp_kernel(px, chip, intensity, t_us, t_us - last_us)
            if not change_below_threshold_kernel(px, last_us, rise):
                emit_crossings_kernel(px, chip, out, last_us, t_us - last_us, rise)
        last_us = t_us
    advance_constant_light_kernel(px, chip, out, last_us)
    return [(int(key) >> KEY_SHIFT, bool(key & 1)) for key in out[1 : 1 + out[0]]]


def plain(pixel: PixelConfig, leak_per_us: float, times_us, intensities, start: float):
    """Run the plain pixel through the same light."""
    one = PlainPixel(pixel, leak_per_us, math.log(start))
    nodes_us, nodes = np.concatenate([[0.0], times_us]), np.concatenate([[start], intensities])
    for tick in range(1, round(times_us[-1] / TICK_US) + 1):
        now_us = tick * TICK_US
        at = min(np.searchsorted(nodes_us, now_us), len(nodes) - 1)
        fraction = (now_us - nodes_us[at - 1]) / (nodes_us[at] - nodes_us[at - 1])
        # The kernels let the log of the light move evenly in a step.
        log = math.log(nodes[at - 1]) * (1 - fraction) + math.log(nodes[at]) * fraction
        one.tick(now_us, math.exp(log))
    return one.events


def scribble(seed: int) -> tuple[np.ndarray, list[float]]:
    """Return light that swings and trembles, with a long rest that is carried in closed form."""
    rng, intensities, tremble = np.random.default_rng(seed), [], 0.0
    for k in range(1500):
        if 500 < k < 900:
            intensities.append(intensities[-1])
            continue
        tremble = 0.9 * tremble + rng.normal(0, 0.01)
        intensities.append(math.exp(min(-1.2 + 1.1 * math.sin(k / 50) + tremble, 0.0)))
    return np.arange(1, 1501) * 30.0, intensities


@pytest.mark.parametrize("bandwidth_hz", [None, 2000.0, 300.0])
@pytest.mark.parametrize("refractory_us", [0.0, 120.0])
@pytest.mark.parametrize("leak_hz", [0.0, 60.0])
def test_a_pixel_fires_as_the_plain_one_does(bandwidth_hz, refractory_us, leak_hz):
    pixel = PixelConfig(
        threshold_on=0.25,
        threshold_off=0.21,
        bandwidth_hz=bandwidth_hz,
        refractory_us=refractory_us,
        leak_hz=leak_hz,
    )
    times_us, intensities = scribble(seed=3)
    sensor = one_pixel(pixel, 0.3)
    # The table is linear in between: start both from what the sensor saw at rest.
    start = float(sensor.pixels[0, 0]["intensity"])
    leak_per_us = float(sensor.pixels[0, 0]["mean_leak_per_us"])
    ours = walk(sensor, times_us, intensities)
    theirs = plain(pixel, leak_per_us, times_us, intensities, start)
    assert len(theirs) >= 20
    assert [on for _, on in ours] == [on for _, on in theirs]
    off_us = np.array([mine[0] - other[0] for mine, other in zip(ours, theirs, strict=True)])
    # The largest are crossings in the flat tail of a slow pixel that settles at rest.
    assert np.abs(off_us).max() < 60.0
    assert np.quantile(np.abs(off_us), 0.8) < 10.0
    assert np.median(np.abs(off_us)) < 5.0


def test_a_resting_pixel_is_due_when_its_leak_says():
    sensor = one_pixel(PixelConfig(leak_hz=10.0), 0.3)
    px, out = sensor.pixels[0, 0], np.zeros(16, np.int64)
    assert predict_leak_event_kernel(px)
    assert px["leak_due_us"] == pytest.approx(100_000.0, rel=1e-5)
    advance_constant_light_kernel(px, sensor.chip[0], out, 350_000.0)
    assert (out[1 : 1 + out[0]] >> KEY_SHIFT) == pytest.approx([1e5, 2e5, 3e5], abs=2)
    predict_leak_event_kernel(px)
    assert px["leak_due_us"] == pytest.approx(400_000.0, rel=1e-5)


def random_image(markers: int, seed: int) -> MarkerImage:
    rng = np.random.default_rng(seed)
    shape = np.eye(2) + rng.normal(0, 0.08, (markers, 2, 2))
    angle = rng.uniform(0, 2 * np.pi, markers)
    chord = np.stack([np.cos(angle), np.sin(angle), rng.uniform(-3, 3, markers)], axis=1)
    chord[::2, 2] = np.inf
    radius = rng.uniform(4, 7, markers)
    radius[-1] = 0.0
    return MarkerImage(0, rng.uniform(-3, 66, (markers, 2)), shape, radius, chord)


def plain_coverage(image: MarkerImage, k: int, x: float, y: float, width_px: float) -> float:
    """Edge of a blurred disc by the definition, its tails uncut."""
    if image.radius_px[k] == 0:
        return 0.0
    place = image.shape[k] @ (np.array([x, y]) - image.center_px[k])
    scale = math.sqrt(abs(np.linalg.det(image.shape[k])))
    covered = ndtr((image.radius_px[k] - np.linalg.norm(place)) / scale / width_px)
    if image.chord is not None and np.isfinite(image.chord[k, 2]):
        left = image.chord[k, 2] - image.chord[k, :2] @ place
        covered *= ndtr(left / scale / width_px)
    return float(covered)


def test_coverage_follows_the_definition_for_ellipses_chords_and_gaps():
    image = random_image(5, seed=1)
    discs = discs_of(image)
    config = CameraConfig(light=LightConfig(blur_px=0.5))
    chip = make_sensor(config, (64, 64), np.random.default_rng(0)).chip[0]
    width_px = math.sqrt(0.25 + 1 / 12)
    expected = np.zeros((64, 64))
    for y in range(64):
        for x in range(64):
            each = [plain_coverage(image, k, x, y, width_px) for k in range(5)]
            expected[y, x] = max(each)
            got = [disc_coverage_kernel(disc, chip, float(x), float(y)) for disc in discs]
            np.testing.assert_allclose(got, each, atol=1.2e-3)  # the cut tails: 5e-4 each
    painted = np.empty((64, 64), np.float32)
    coverage_image_kernel(discs, chip, painted)
    np.testing.assert_allclose(painted, expected, atol=1.2e-3)


@pytest.mark.parametrize("seed", range(6))
def test_the_plan_groups_markers_as_a_graph_search_does(seed):
    rng = np.random.default_rng(seed)
    before, after = (discs_of(random_image(12, seed)) for _ in range(2))
    moving = rng.random(12) < 0.4
    after["x"][moving] += rng.uniform(-3, 3, moving.sum())
    plan = np.zeros(12, SWEEP_PLAN_DTYPE)
    plan_sweep_kernel(before, after, 2.0, 4000.0, (1000.0, 0.001), plan)
    expected = plain_groups(plan, moving)
    assert plan["leader"].tolist() == expected
    for first in set(expected) - {-1}:
        chain, k = [], first
        while k >= 0:
            chain.append(k)
            k = int(plan["following"][k])
        assert chain == [k for k in range(12) if expected[k] == first]
        travel_px = max(abs(float(after["x"][k] - before["x"][k])) for k in chain)
        assert plan["steps"][first] == max(4, math.ceil(travel_px / 0.1 - 1e-9))


def plain_groups(plan: np.ndarray, moving: np.ndarray) -> list[int]:
    """Return each marker's lowest companion through overlapping boxes, -1 where nothing moves."""
    meet = (plan["x_last"] >= plan["x_first"])[:, None] & np.ones(len(plan), bool)
    for axis in "xy":
        first, last = plan[f"{axis}_first"], plan[f"{axis}_last"]
        meet &= (first[:, None] <= last) & (first <= last[:, None])
    label = connected_components(meet & meet.T, directed=False)[1]
    groups = [np.flatnonzero(label == one) for one in label]
    return [int(group[0]) if moving[group].any() else -1 for group in groups]


def test_the_background_is_poisson_in_time_and_even_in_space():
    source = make_noise(BackgroundConfig(rate_hz=2.0), 4096, np.random.default_rng(1))
    start_noise(source, 0.0)
    out = np.zeros(1 << 18, np.int64)
    assert background_events_kernel(source, 20e6, out)
    keys = out[1 : 1 + out[0]]
    times_us, pixel, on = keys >> KEY_SHIFT, (keys & 0xFFFFFF) >> 1, keys & 1
    assert len(keys) / 4096 / 20 == pytest.approx(2.0, rel=0.02)
    counts = np.histogram(times_us, 2000, (0, 20e6))[0]
    assert counts.var() / counts.mean() == pytest.approx(1.0, abs=0.12)
    per_pixel = np.bincount(pixel, minlength=4096)
    assert per_pixel.var() / per_pixel.mean() == pytest.approx(1.0, abs=0.08)
    assert on.mean() == pytest.approx(0.5, abs=0.01)
    for i in (0, 17, 4095):
        one = on[pixel == i]
        assert (np.diff(one) != 0).all()  # polarities alternate


def test_a_full_outbox_stops_the_background_and_loses_nothing():
    def collect(room: int) -> np.ndarray:
        source = make_noise(BackgroundConfig(rate_hz=50.0), 100, np.random.default_rng(2))
        start_noise(source, 0.0)
        parts, out = [], np.zeros(room, np.int64)
        while True:
            done = background_events_kernel(source, 1e6, out)
            parts.append(out[1 : 1 + out[0]].copy())
            out[0] = 0
            if done:
                return np.concatenate(parts)

    np.testing.assert_array_equal(collect(7), collect(1 << 16))
