"""Sensor time against host time: lag, drift and leaps, on clocks that only the tests move."""

from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from spikingtac.robot.watchdog import BACKLOG_S
from spikingtac.stream.clock import StreamClock

OFFSET_S = 1234.5  # Host time less sensor time, of a transport that takes no time.


def worst(arrivals: Iterable[tuple[int, float]]) -> tuple[float, float]:
    """Return the longest backlog and leap of windows that end and arrive at these times."""
    clock, backlog_s, leap_s = StreamClock(), 0.0, 0.0
    for end_us, host_s in arrivals:
        leap_s = max(leap_s, clock.arrive(end_us, host_s))
        backlog_s = max(backlog_s, clock.backlog_s(end_us, host_s))
    return backlog_s, leap_s


@pytest.mark.parametrize("drift", [-90e-6, 90e-6])
def test_an_hour_of_drift_between_the_clocks_is_no_lag_and_no_leap(drift: float) -> None:
    seconds = range(3600)
    backlog_s, leap_s = worst((s * 1_000_000, OFFSET_S + s * (1.0 + drift)) for s in seconds)
    assert backlog_s < 1e-4
    assert leap_s == 0.0


@pytest.mark.parametrize("leap_s", [0.6, 600.0, 8_000.0])
def test_a_leap_of_the_sensors_clock_is_told_once(leap_s: float) -> None:
    clock = StreamClock()
    for number in range(1, 1_001):
        clock.arrive(1_000 * number, OFFSET_S + 1e-3 * number)
    host_s = OFFSET_S + 1.001
    assert clock.arrive(round((1.001 + leap_s) * 1e6), host_s) == pytest.approx(leap_s, abs=1e-3)
    assert clock.arrive(round((1.002 + leap_s) * 1e6), host_s + 0.001) == 0.0
    assert clock.backlog_s(round((1.002 + leap_s) * 1e6), host_s + 0.001) < 1e-6


def busy_arrivals(
    rng: np.random.Generator, windows: int, drift: float = 0.0, pauses: float = 0.002
) -> Iterator[tuple[int, float]]:
    """Yield windows of a camera beside a busy machine: bursts of eight, jitter, pauses to 15 ms."""
    free_s = 0.0
    for number in range(windows):
        end_us = (number + 1) * 1000
        sent_s = OFFSET_S + (number // 8 + 1) * 0.008 * (1.0 + drift)
        pause_s = rng.uniform(0.0, 0.015) if rng.random() < pauses else 0.0
        free_s = max(free_s, sent_s + rng.exponential(1e-4)) + pause_s + 2e-4
        yield end_us, free_s


@pytest.mark.parametrize("seed", range(3))
def test_a_minute_beside_a_busy_machine_trips_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arrivals = busy_arrivals(rng, 60_000, drift=rng.uniform(-8e-5, 8e-5))
    backlog_s, leap_s = worst(arrivals)
    assert backlog_s < BACKLOG_S
    assert leap_s == 0.0


@pytest.mark.parametrize("seed", range(8))
def test_each_lag_is_seen_in_a_fifth_of_a_second(seed: int) -> None:
    """From some window on, each needs more time than it spans."""
    rng = np.random.default_rng(seed)
    begin, slower = int(rng.integers(200, 1000)), rng.uniform(1.2, 4.0)
    clock, late_s, fault_s = StreamClock(), 0.0, 0.0
    for number, (end_us, arrived_s) in enumerate(busy_arrivals(rng, 2000, pauses=0.0)):
        if number >= begin:
            late_s += (slower - 1.0) * 1e-3
            fault_s = fault_s or arrived_s
        host_s = arrived_s + late_s
        clock.arrive(end_us, host_s)
        if clock.backlog_s(end_us, host_s) > BACKLOG_S:
            assert number >= begin
            assert host_s - fault_s < 0.2
            return
    raise AssertionError("the lag was not seen")
