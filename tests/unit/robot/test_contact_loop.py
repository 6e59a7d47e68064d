"""The contact path: decide first, stop, and never wait for anybody."""

import time
from collections.abc import Iterator
from dataclasses import replace

import pytest

from spikingtac.contact.registry import EventCountDetector
from spikingtac.events.source import PacketSource
from spikingtac.robot.guard_loop import Arrival, ContactLoop, watched_windows
from spikingtac.robot.watchdog import Health, Watchdog
from spikingtac.stream.reader import EventReader
from spikingtac.types import EventPacket
from stand_ins.moving_rims import SIZE, windows


class Bench:
    """A loop over a clock that only the stream moves, 1 ms per window plus a transport."""

    def __init__(self) -> None:
        self.now_s, self.order = 1000.0, list[str]()
        stop = lambda: self.order.append("stop")  # noqa: E731
        self.watchdog = Watchdog(stop, self.clock)
        self.watchdog.self_test()
        self.watchdog.arm()
        self.order.clear()
        detector = EventCountDetector(40)
        self.loop = ContactLoop(detector, self.watchdog, stop, self.clock)

    def clock(self) -> float:
        return self.now_s

    def arrivals(self, late_s: float = 0.0, queued_s: float = 0.0) -> Iterator[Arrival]:
        for window in windows(200, seed=1, speed=lambda k: (0.1 * (k >= 100), 0.0)):
            late = window.t_start_us >= 50_000
            self.now_s = 1000.0 + window.t_end_us * 1e-6 + late_s * late
            received_s = self.now_s
            self.now_s += queued_s * late
            yield Arrival(window, received_s)


def test_the_stop_is_sent_before_anything_else_is_done_with_the_window() -> None:
    bench = Bench()
    report = bench.loop.guard(bench.arrivals(), lambda _: bench.order.append("show"))
    assert report["contact"]["t_us"] == 101_000
    assert bench.order[-2:] == ["stop", "show"]
    assert bench.order.count("stop") == 1
    assert report["windows"] == 101
    assert report["health"] == Health.OK.value


def test_the_latency_is_split() -> None:
    bench = Bench()
    report = bench.loop.guard(bench.arrivals(late_s=0.0007, queued_s=0.002))
    drift_us = 100e-6 * 50_000  # what the clocks may have drifted apart meanwhile
    assert report["latency"]["transport_us"] == pytest.approx(700.0, abs=drift_us + 1.0)
    assert report["latency"]["decision_us"] == pytest.approx(2000.0, abs=1.0)
    assert report["latency"]["stop_us"] == 0.0
    assert report["latency"]["window_us"] == pytest.approx(500.0, abs=150.0)


def test_a_queue_that_grows_is_an_overload() -> None:
    bench = Bench()
    report = bench.loop.guard(bench.arrivals(queued_s=0.006))
    assert report["health"] == Health.OVERLOAD.value
    assert report["windows"] == 51 + 20  # once it has lasted for 20 ms
    assert bench.order == ["stop"]


def test_a_leap_of_the_sensors_clock_trips_whatever_fills_it() -> None:
    bench = Bench()

    def leaping() -> Iterator[Arrival]:
        for window in windows(100, seed=1):
            bench.now_s = 1000.0 + window.t_end_us * 1e-6
            yield Arrival(window, bench.now_s)
        for start_us in range(100_000, 600_000_000, 1000):  # read faster than they happen
            bench.now_s += 1e-5
            yield Arrival(EventPacket.empty(start_us, start_us + 1000, SIZE), bench.now_s)

    report = bench.loop.guard(leaping())
    assert report["health"] == Health.TIME_JUMP.value
    assert report["windows"] < 100 + 600
    assert bench.order == ["stop"]


def test_a_leap_that_the_stream_counts_trips() -> None:
    bench = Bench()
    arrivals = (
        replace(arrival, losses={"time_jump": 3 + (number >= 50)})
        for number, arrival in enumerate(bench.arrivals())
    )
    report = bench.loop.guard(arrivals)
    assert (report["health"], report["windows"]) == (Health.TIME_JUMP.value, 51)


@pytest.mark.parametrize("leap_us", [300_000, 450_000])
def test_a_small_leap_is_counted_once_and_stops_nothing(leap_us: int) -> None:
    bench = Bench()

    def leaping() -> Iterator[Arrival]:
        for window in windows(600, seed=1):
            bench.now_s = 1000.0 + window.t_end_us * 1e-6
            late_us = leap_us * (window.t_start_us >= 100_000)
            span = window.t_start_us + late_us, window.t_end_us + late_us
            moved = replace(window, t=window.t + late_us, t_start_us=span[0], t_end_us=span[1])
            yield Arrival(moved, bench.now_s, {"damaged": 2})

    report = bench.loop.guard(leaping())
    assert (report["reason"], report["leaps"]) == ("the event stream ended", 1)
    assert report["losses"] == {"damaged": 2}


def test_windows_come_in_order_and_a_consumer_that_lags_is_an_overload() -> None:
    # A busy machine is no stall.
    watchdog = Watchdog(lambda: None, time.monotonic, stale_s=20.0, backlog_s=0.1)
    watchdog.self_test()
    watchdog.arm()
    source, seen = PacketSource(list(windows(400, seed=0)), SIZE), list[int]()
    for window in watched_windows(EventReader(source, source), watchdog):
        seen.append(window[0].t_start_us)
        time.sleep(0.003)
        if watchdog.check() is not Health.OK:
            break
    assert seen == list(range(0, 1_000 * len(seen), 1_000))
    assert watchdog.health is Health.OVERLOAD
