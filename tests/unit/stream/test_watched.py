"""Windows of a camera whose every packet is a heartbeat of a watchdog."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from spikingtac.errors import DeviceError, RecordingError
from spikingtac.events.formats.codec import Triggers
from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig, WatchdogThread
from spikingtac.stream.arrivals import watched_windows
from spikingtac.stream.reader import EventReader
from spikingtac.types import EventPacket, LossCounters
from stand_ins.moving_rims import SIZE, windows

STALLED_S = 20.0  # A stream that stalls is waited for no longer than this.


class Stream:
    """Packets at once; then the stream stalls, or breaks."""

    size = SIZE

    def __init__(self, count: int, fault: Exception | None = None, stalls: bool = False) -> None:
        self.losses, self.triggers = LossCounters(), Triggers()
        self._count, self._fault, self.stalls = count, fault, stalls

    def __iter__(self) -> Iterator[EventPacket]:
        yield from windows(self._count, seed=0)
        until_s = time.monotonic() + STALLED_S
        while self.stalls and time.monotonic() < until_s:
            time.sleep(0.01)
        if self._fault is not None:
            raise self._fault


@pytest.fixture
def watchdog() -> Watchdog:
    config = WatchdogConfig(stale_s=0.2, backlog_s=0.3)
    found = Watchdog(config, lambda: None, time.monotonic)
    found.self_test()
    return found


def starts(reader: EventReader, watchdog: Watchdog) -> list[int]:
    return [window[0].t_start_us // 1_000 for window in watched_windows(reader, watchdog)]


def test_windows_come_in_order_and_what_waits_can_be_given_up(watchdog: Watchdog) -> None:
    stream = Stream(50)
    assert starts(EventReader(stream, stream), watchdog) == list(range(50))
    reader = EventReader(stream, stream)
    while not reader.ended:
        time.sleep(0.001)
    reader.give_up()
    assert starts(reader, watchdog) == []


def test_a_stall_stops_the_arm_and_wakes_the_consumer(watchdog: Watchdog) -> None:
    stream = Stream(20, stalls=True)
    watchdog.arm()
    with WatchdogThread(watchdog), pytest.raises(DeviceError, match="stale"):
        starts(EventReader(stream, stream), watchdog)
    stream.stalls = False


def test_a_consumer_that_lags_is_an_overload() -> None:
    config = WatchdogConfig(stale_s=STALLED_S, backlog_s=0.1)  # a busy machine is no stall
    watchdog = Watchdog(config, lambda: None, time.monotonic)
    watchdog.self_test()
    watchdog.arm()
    stream = Stream(400)
    for _ in watched_windows(EventReader(stream, stream), watchdog):
        time.sleep(0.003)
        if watchdog.check() is not Health.OK:
            break
    assert watchdog.health is Health.OVERLOAD


@pytest.mark.parametrize("fault", [RecordingError("cable"), OSError("usb")])
def test_a_failure_is_raised(fault: Exception, watchdog: Watchdog) -> None:
    stream = Stream(3, fault)
    with pytest.raises(type(fault), match=str(fault)):
        starts(EventReader(stream, stream), watchdog)
