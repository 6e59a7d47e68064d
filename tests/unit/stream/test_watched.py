"""A stream read at once, by whoever is busy elsewhere, under a watchdog's eyes."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from spikingtac.errors import DeviceError, RecordingError
from spikingtac.events.formats.codec import Triggers
from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig, WatchdogThread
from spikingtac.stream.arrivals import WatchedWindows
from spikingtac.types import EventPacket, LossCounters
from stand_ins.moving_rims import SIZE, windows

PATIENCE_S = 20.0


class Stream:
    """Packets on demand: ``give`` lets some pass, then the stream waits, ends or breaks."""

    size = SIZE

    def __init__(self, count: int, fault: Exception | None = None) -> None:
        self.losses, self.triggers = LossCounters(), Triggers()
        self._packets = list(windows(count, seed=0))
        self._fault = fault
        self.go_on = threading.Semaphore(0)
        self.read = 0

    def give(self, count: int) -> None:
        for _ in range(count):
            self.go_on.release()

    def __iter__(self) -> Iterator[EventPacket]:
        for packet in self._packets:
            assert self.go_on.acquire(timeout=PATIENCE_S)
            self.read += 1
            yield packet
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
    watched = WatchedWindows(stream, watchdog)
    stream.give(50)
    until(lambda: stream.read == 50)
    taken = [window[0].t_start_us for window in watched]
    assert taken == [1000 * number for number in range(50)]


def test_what_waits_can_be_skipped_and_is_not_filled_with_silence(watchdog: Watchdog) -> None:
    stream = Stream(3_000)
    watched = WatchedWindows(stream, watchdog)
    taken = iter(watched)
    stream.give(100)
    first = [next(taken)[0].t_start_us for _ in range(10)]
    stream.give(1_900)
    until(lambda: stream.read == 2_000)
    time.sleep(0.05)
    watched.skip()
    stream.give(1_000)
    assert first == [1000 * number for number in range(10)]
    rest = [window[0].t_start_us for window in taken]
    assert [t for t in rest if t >= 11_000] == [1000 * number for number in range(2_000, 3_000)]


def test_a_stall_stops_the_arm_and_wakes_the_consumer(
    watchdog: Watchdog, stops: list[float]
) -> None:
    stream = Stream(20)
    watched = WatchedWindows(stream, watchdog)
    watchdog.arm()
    with WatchdogThread(watchdog):
        stream.give(5)
        with pytest.raises(DeviceError, match="stale"):
            list(watched)
    assert stops
    stream.give(15)


def test_a_consumer_that_lags_is_an_overload(stops: list[float]) -> None:
    config = WatchdogConfig(stale_s=PATIENCE_S, backlog_s=0.3)  # a busy machine is no stall
    watchdog = Watchdog(config, lambda: stops.append(time.monotonic()), time.monotonic)
    watchdog.self_test()
    stops.clear()
    stream = Stream(400)
    watched = WatchedWindows(stream, watchdog)
    watchdog.arm()
    with WatchdogThread(watchdog):
        for _ in range(100):
            stream.give(4)
            time.sleep(0.01)
            if stops:
                break
    assert watchdog.health is Health.OVERLOAD
    assert len(list(watched._unused)) > 10
    stream.give(400)


@pytest.mark.parametrize(
    ("fault", "raised"), [(None, None), (RecordingError("cable"), "cable"), (OSError("usb"), "usb")]
)
def test_an_end_or_a_failure_trips_and_is_told(
    fault: Exception | None, raised: str | None, watchdog: Watchdog, stops: list[float]
) -> None:
    stream = Stream(3, fault)
    watched = WatchedWindows(stream, watchdog)
    stream.give(3)
    if raised is None:
        assert len(list(watched)) == 3
    else:
        with pytest.raises(type(fault), match=raised):
            list(watched)
    until(lambda: watchdog.health is Health.DISCONNECTED)
    assert stops
