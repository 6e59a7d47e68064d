"""A stream read at once, by whoever is busy elsewhere, under a watchdog's eyes."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from spikingtac.errors import DeviceError, RecordingError
from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig, WatchdogThread
from spikingtac.stream.guard_loop import Arrival
from spikingtac.stream.reader import ThreadedSource
from stand_ins.moving_rims import windows

PATIENCE_S = 20.0


class Stream:
    """Windows on demand: ``give`` lets some pass, then the stream waits, ends or breaks."""

    def __init__(self, count: int, fault: Exception | None = None) -> None:
        self._windows = list(windows(count, seed=0))
        self._fault = fault
        self.go_on = threading.Semaphore(0)
        self.read = 0

    def give(self, count: int) -> None:
        for _ in range(count):
            self.go_on.release()

    def __iter__(self) -> Iterator[Arrival]:
        for window in self._windows:
            assert self.go_on.acquire(timeout=PATIENCE_S)
            self.read += 1
            yield Arrival((window,), time.monotonic())
        if self._fault is not None:
            raise self._fault


def until(condition) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.001)


@pytest.fixture
def stops() -> list[float]:
    return []


@pytest.fixture
def watchdog(stops: list[float]) -> Watchdog:
    config = WatchdogConfig(stale_s=0.2, backlog_s=0.3)
    found = Watchdog(config, lambda: stops.append(time.monotonic()), time.monotonic)
    found.self_test()
    stops.clear()
    return found


def test_windows_are_read_though_nobody_takes_them_and_come_in_order(watchdog: Watchdog) -> None:
    stream = Stream(50)
    pump = ThreadedSource(stream, watchdog)
    stream.give(50)
    until(lambda: stream.read == 50)
    taken = [window[0].t_start_us for window in pump]
    assert taken == [1000 * number for number in range(50)]


def test_a_stall_stops_the_arm_and_wakes_the_consumer(
    watchdog: Watchdog, stops: list[float]
) -> None:
    stream = Stream(20)
    pump = ThreadedSource(stream, watchdog)
    watchdog.arm()
    with WatchdogThread(watchdog):
        stream.give(5)
        with pytest.raises(DeviceError, match="stale"):
            list(pump)
    assert stops
    stream.give(15)


def test_a_consumer_that_lags_is_an_overload(stops: list[float]) -> None:
    config = WatchdogConfig(stale_s=PATIENCE_S, backlog_s=0.3)  # a busy machine is no stall
    watchdog = Watchdog(config, lambda: stops.append(time.monotonic()), time.monotonic)
    watchdog.self_test()
    stops.clear()
    stream = Stream(400)
    pump = ThreadedSource(stream, watchdog)
    watchdog.arm()
    with WatchdogThread(watchdog):
        for _ in range(100):
            stream.give(4)
            time.sleep(0.01)
            if stops:
                break
    assert watchdog.health is Health.OVERLOAD
    with pytest.raises(DeviceError, match="overload"):
        list(pump)
    stream.give(400)


@pytest.mark.parametrize(
    ("fault", "raised"), [(None, None), (RecordingError("cable"), "cable"), (OSError("usb"), "usb")]
)
def test_an_end_or_a_failure_trips_and_is_told(
    fault: Exception | None, raised: str | None, watchdog: Watchdog, stops: list[float]
) -> None:
    stream = Stream(3, fault)
    pump = ThreadedSource(stream, watchdog)
    stream.give(3)
    if raised is None:
        assert len(list(pump)) == 3
    else:
        with pytest.raises(type(fault), match=raised):
            list(pump)
    until(lambda: watchdog.health is Health.DISCONNECTED)
    assert stops


def test_a_closed_pump_reads_no_further(watchdog: Watchdog) -> None:
    stream = Stream(20)
    pump = ThreadedSource(stream, watchdog)
    stream.give(2)
    until(lambda: stream.read == 2)
    pump.close()
    stream.give(18)
    time.sleep(0.05)
    assert stream.read == 3
    assert watchdog.health is Health.OK
