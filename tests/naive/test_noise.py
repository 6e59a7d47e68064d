"""The background against what a Poisson process is by definition."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.sim.camera_config import BackgroundConfig
from spikingtac.sim.pixels import KEY_SHIFT
from spikingtac.sim.readout import background_events_kernel, make_noise, start_noise


def test_the_background_is_poisson_in_time_and_even_in_space():
    config = BackgroundConfig(rate_hz=2.0)
    source = make_noise(config, 4096, np.random.default_rng(1))
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
