import pytest

from spikingtac.sim.camera_config import (
    CAMERA_NAMES,
    load_camera,
)

PINNED = {  # contrast, threshold, mismatch, bandwidth, leak, background, hot, dead, latency, jitter
    "clean": (6.0, 0.25, 0.0, None, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, None),
    "typical": (6.0, 0.25, 0.03, 2000.0, 0.07, 0.1, 1e-4, 50.0, 150.0, 30.0, 10.0),
    "noisy": (6.0, 0.25, 0.03, 500.0, 0.2, 1.0, 1e-4, 100.0, 150.0, 30.0, 10.0),
}


@pytest.mark.parametrize("name", CAMERA_NAMES)
def test_the_presets_hold_the_pinned_values(name):
    camera = load_camera(name)
    pixel, background = camera.pixel, camera.background
    assert (
        camera.light.contrast,
        pixel.threshold_on,
        pixel.mismatch,
        pixel.bandwidth_hz,
        pixel.leak_hz,
        background.rate_hz,
        background.hot_fraction,
        pixel.refractory_us,
        pixel.latency_us,
        pixel.jitter_us,
        camera.readout.cap_mev_s,
    ) == PINNED[name]
    assert camera.size == (320, 320)
    assert pixel.threshold_off == pixel.threshold_on
    assert camera.readout.loss == 0.0
