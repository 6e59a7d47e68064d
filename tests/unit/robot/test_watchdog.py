"""The watchdog trips, latches, needs its self-test, and never swallows a failed stop."""

import threading
import time

import pytest

from spikingtac.errors import DeviceError
from spikingtac.robot.watchdog import (
    Health,
    Watchdog,
    WatchdogConfig,
    WatchdogThread,
)


class Bench:
    """A clock that stands still, and an arm that counts its stops."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.stops = 0
        self.broken = False
        self.watchdog = Watchdog(WatchdogConfig(), self.stop, lambda: self.now_s)

    def stop(self) -> None:
        self.stops += 1
        if self.broken:
            raise DeviceError("no answer")

    def armed(self) -> Watchdog:
        self.watchdog.self_test()
        self.watchdog.arm()
        self.stops = 0
        return self.watchdog


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_silence_of_the_transport_trips_once_and_latches(bench: Bench) -> None:
    watchdog = bench.armed()
    bench.now_s += 0.039
    assert watchdog.check() is Health.OK
    bench.now_s += 0.002
    assert watchdog.check() is Health.STALE
    assert bench.stops == 1
    assert "41.0 ms" in watchdog.reason
    watchdog.beat()
    assert watchdog.check() is Health.STALE
    assert not watchdog.armed


def test_lag_behind_the_newest_data_is_an_overload(bench: Bench) -> None:
    watchdog = bench.armed()
    watchdog.beat(backlog_s=0.004)
    assert watchdog.check() is Health.OK
    watchdog.beat(backlog_s=0.006)
    assert watchdog.check() is Health.OVERLOAD
    assert bench.stops == 1


def test_it_cannot_be_armed_unproven_or_tripped(bench: Bench) -> None:
    with pytest.raises(DeviceError, match="self_test"):
        bench.watchdog.arm()
    watchdog = bench.armed()
    bench.now_s += 1.0
    watchdog.check()
    with pytest.raises(DeviceError, match="reset it first"):
        watchdog.arm()
    watchdog.reset()
    assert watchdog.health is Health.OK
    with pytest.raises(DeviceError, match="self_test"):
        watchdog.arm()
    bench.armed()


def test_the_self_test_proves_that_the_arm_takes_a_stop(bench: Bench) -> None:
    bench.watchdog.self_test()
    assert bench.stops == 1
    assert bench.watchdog.health is Health.OK
    bench.broken = True
    with pytest.raises(DeviceError, match="could not stop the arm: no answer"):
        bench.watchdog.self_test()
    with pytest.raises(DeviceError, match="self_test"):
        bench.watchdog.arm()


def test_a_failed_stop_is_tried_again(bench: Bench) -> None:
    watchdog = bench.armed()
    bench.broken = True
    bench.now_s += 1.0
    assert watchdog.check() is Health.STALE
    assert isinstance(watchdog.stop_failure, DeviceError)
    watchdog.check()
    assert bench.stops == 2
    bench.broken = False
    watchdog.check()
    watchdog.check()
    assert bench.stops == 3
    assert watchdog.stop_failure is None


def test_its_thread_catches_a_loop_that_hangs() -> None:
    stopped = threading.Event()
    watchdog = Watchdog(WatchdogConfig(stale_s=0.05), stopped.set, time.monotonic)
    watchdog.self_test()
    stopped.clear()
    watchdog.arm()
    with WatchdogThread(watchdog):
        assert stopped.wait(5.0)
    assert watchdog.health is Health.STALE


def test_a_stop_that_is_not_confirmed_is_a_failure_and_is_told_again(bench: Bench) -> None:
    told: list[str] = []
    stuck = [True]

    def confirm() -> None:
        if stuck[0] and watchdog.armed is False and told:
            raise DeviceError("it moves")

    watchdog = Watchdog(
        WatchdogConfig(),
        bench.stop,
        lambda: bench.now_s,
        lambda: told.append(str(watchdog.stop_failure)),
        confirm,
    )
    watchdog.self_test()
    watchdog.arm()
    bench.now_s += 1.0
    assert watchdog.check() is Health.STALE
    assert told == ["None", "it moves"]  # the trip at once, the failure when it is known
    watchdog.check()
    assert told == ["None", "it moves"]
    stuck[0] = False
    watchdog.check()
    assert told[-1] == "None"
    assert watchdog.stop_failure is None


def test_a_stop_that_failed_at_a_contact_is_told_and_tried_again(bench: Bench) -> None:
    watchdog = bench.armed()
    watchdog.stop_failed(DeviceError("it moves"))
    assert (watchdog.health, watchdog.armed) == (Health.NOT_STOPPED, False)
    assert "at a contact" in watchdog.reason
    watchdog.check()
    assert bench.stops == 1
    assert watchdog.stop_failure is None
