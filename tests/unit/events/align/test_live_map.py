"""Two cameras that deliver: times of one on the other's clock, in order from the first event on."""

from __future__ import annotations

import numpy as np

from spikingtac.events.delivery import ClockFit
from spikingtac.stream.pair import LiveMap


def run(seed: int, away_s: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Deliver both every 2 ms with late arrivals; return mapped times and true ones, us."""
    rng = np.random.default_rng(seed)
    base, own = ClockFit(), ClockFit()
    live = LiveMap(own.mapping, base.mapping)
    found, truth = [], []
    for now_s in np.arange(0.0, 20.0, 0.002):
        host_s = 500.0 + now_s
        base_us, own_us = now_s * (1 - 30e-6) * 1e6, (now_s + 7.25) * (1 + 50e-6) * 1e6
        base.arrived(round(base_us), host_s + 3e-4 + rng.exponential(2e-3))
        if now_s < away_s:
            continue
        own.arrived(round(own_us), host_s + 3e-4 + rng.exponential(2e-3))
        events_us = np.sort(rng.integers(round(own_us) - 2_000, round(own_us) + 1, 20))
        found.append(live(events_us))
        truth.append(base_us + (events_us - own_us) * (1 - 80e-6))
    return np.concatenate(found), np.concatenate(truth)


def test_times_stay_in_order_and_come_near_the_truth() -> None:
    for seed in range(3):
        found, truth = run(seed)
        packets = found.reshape(-1, 20)
        assert (np.diff(packets, axis=1) >= 0).all()
        assert (packets[1:, 0] - packets[:-1, -1] >= -1).all()
        error_us = np.abs(found - truth)
        assert error_us.max() < 12_000  # the first delivery may be late by so much
        assert error_us[len(error_us) // 2 :].max() < 300


def test_a_camera_that_comes_later_is_placed_at_once() -> None:
    found, truth = run(5, away_s=10.0)
    assert np.abs(found - truth).max() < 12_000


def test_before_the_other_one_has_delivered_times_are_as_they_are() -> None:
    own = ClockFit()
    own.arrived(1_000, 5.0)
    live = LiveMap(own.mapping, ClockFit().mapping)
    assert live(np.array([1_000, 1_500])).tolist() == [1_000, 1_500]
    assert live.known is None
