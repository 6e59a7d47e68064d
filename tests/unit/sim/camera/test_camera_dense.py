from dataclasses import replace

import numpy as np
import pytest

from spikingtac.sim.camera_config import CameraConfig, LightConfig, PixelConfig, StepConfig
from spikingtac.sim.event_camera import EventCamera
from spikingtac.sim.optics import MarkerImage
from spikingtac.sim.sweep import sample_pattern_kernel

SIZE = (64, 64)
TYPICAL = PixelConfig(mismatch=0.03, bandwidth_hz=2000.0, refractory_us=50.0, latency_us=150.0)


def images(speed_px_s: float, span_us: int, period_us: int = 2000) -> list[MarkerImage]:
    centers = np.array([[24.3, 30.2]])
    return [
        MarkerImage(
            t_us=t,
            center_px=centers + speed_px_s * t * 1e-6,
            shape=np.eye(2)[None],
            radius_px=np.array([7.0]),
        )
        for t in range(0, span_us + 1, period_us)
    ]


def film(config: CameraConfig, shots: list[MarkerImage], history="random"):
    sensor = EventCamera(config, seed=2)
    sensor.settle(shots[0], history)
    return sensor.advance(shots[1:])


@pytest.mark.parametrize("speed_px_s", [20.0, 300.0])
def test_every_pixel_at_every_step_gives_what_the_edges_alone_give(speed_px_s):
    """The dense renderer is the sweep's plain twin: it neither skips nor carries forward."""
    steps = StepConfig(max_us=200.0)
    quick = CameraConfig(size=SIZE, pixel=TYPICAL, steps=steps)
    thorough = replace(quick, light=LightConfig(texture=1e-9, texture_follow=1.0))
    shots = images(speed_px_s, 60_000)
    one, two = film(quick, shots), film(thorough, shots)
    assert len(one) == pytest.approx(len(two), rel=0.005)
    keys = [np.stack([packet.y, packet.x, packet.p]).astype(int) for packet in (one, two)]
    counts = [np.zeros((64, 64, 2), int) for _ in keys]
    for count, (y, x, p) in zip(counts, keys, strict=True):
        np.add.at(count, (y, x, p), 1)
    assert np.abs(counts[0] - counts[1]).sum() <= 0.01 * len(one)
    times = [np.sort(packet.t) for packet in (one, two)]
    shared = min(len(times[0]), len(times[1]))
    assert np.median(np.abs(times[0][:shared] - times[1][:shared])) < 100


def test_a_pattern_is_read_between_its_samples_and_repeats():
    pattern = np.random.default_rng(1).random((5, 7)).astype(np.float32)
    assert sample_pattern_kernel(pattern, 2.0, 3.0) == pytest.approx(float(pattern[3, 2]))
    middle = pattern[[3, 3, 4, 4], [2, 3, 2, 3]].mean()
    assert sample_pattern_kernel(pattern, 2.5, 3.5) == pytest.approx(float(middle))
    assert sample_pattern_kernel(pattern, -0.5, 0.0) == pytest.approx(
        float(pattern[0, [6, 0]].mean())
    )
    assert sample_pattern_kernel(pattern, 7.25, 5.0) == pytest.approx(
        sample_pattern_kernel(pattern, 0.25, 0.0)
    )
