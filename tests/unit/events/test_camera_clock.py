"""The sensor's clock on the host's: offset and drift are found within the error that is stated."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.events.clock import TimeMap
from spikingtac.events.delivery import ClockFit, DeliveryMeter


def fitted(drift_ppm: float, seconds: float, seed: int = 0, jitter_ms: float = 2.0) -> TimeMap:
    """Deliver every 4 ms; transport takes 0.2 ms and often more."""
    rng = np.random.default_rng(seed)
    fit = ClockFit()
    for sensor_s in np.arange(0.0, seconds, 0.004):
        late_s = 2e-4 + rng.exponential(jitter_ms * 1e-3)
        host_s = 1_000.0 + sensor_s * (1.0 + drift_ppm * 1e-6) + late_s
        fit.arrived(round(sensor_s * 1e6), host_s)
    mapping = fit.mapping()
    assert mapping is not None
    return mapping


@pytest.mark.parametrize("drift_ppm", [-80.0, 0.0, 35.0])
def test_drift_and_offset_are_found_within_five_errors(drift_ppm: float) -> None:
    mapping = fitted(drift_ppm, seconds=120.0)
    assert mapping.drift_error_ppm is not None
    assert mapping.drift_error_ppm < 1.0
    assert abs(mapping.drift_ppm - drift_ppm) < 5.0 * mapping.drift_error_ppm
    truth_s = 1_000.0 + 60.0 * (1.0 + drift_ppm * 1e-6)
    assert 0.0 < mapping.host_s(60e6) - truth_s < 5e-4  # holds the fastest transport, 0.2 ms


def test_there_and_back() -> None:
    mapping = fitted(20.0, seconds=10.0)
    assert mapping.inverse().at(mapping.at(1_234_567)) == pytest.approx(1_234_567, abs=0.5)


def test_a_short_stretch_states_no_drift() -> None:
    mapping = fitted(50.0, seconds=1.0)
    assert mapping.drift_error_ppm is None
    assert mapping.drift_ppm == 0.0


def test_memory_stays_bounded_and_the_line_the_same() -> None:
    fit = ClockFit()
    for number in range(20_000):
        fit.arrived(number * 100_000, 5.0 + number * 0.1 * (1.0 + 1e-5))
    mapping = fit.mapping()
    assert mapping is not None
    assert len(fit._bins[0]) < 4096
    assert mapping.drift_ppm == pytest.approx(10.0, abs=0.1)


def test_nothing_is_known_before_the_first_delivery() -> None:
    assert ClockFit().mapping() is None


def test_the_interval_of_deliveries_is_told_in_words() -> None:
    now = [0.0]
    meter = DeliveryMeter(lambda: now[0])
    assert "nothing" in meter.health({}).sentence
    for number in range(100):
        now[0] = 0.004 * number
        meter.delivered(50, now[0])
    health = meter.health({"gap": 2})
    assert health.interval_p50_ms == pytest.approx(4.0)
    assert health.sentence.startswith("packets every 4.0 ms")
    assert "a 1 ms window is not a 1 ms latency" in health.sentence
    assert (health.events, health.losses) == (5_000, {"gap": 2})
