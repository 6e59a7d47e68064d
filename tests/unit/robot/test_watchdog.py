"""A stop is watched, repeated and told: by the watchdog, and by the reported speed of an arm."""

import subprocess
import sys
import threading
import time

import pytest

from spikingtac.errors import DeviceError
from spikingtac.robot.ur_client import BoundedCalls
from spikingtac.robot.ur_stop import Means, Report, VerifiedStop
from spikingtac.robot.watchdog import Health, Watchdog


class Bench:
    """A clock that stands still, and an arm that counts its stops."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.stops = 0
        self.broken = False
        self.watchdog = Watchdog(self.stop, lambda: self.now_s)

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
    watchdog.disconnected("the event stream ended")  # closing the camera had taken a while
    assert (watchdog.check(), watchdog.reason) == (Health.DISCONNECTED, "the event stream ended")


def test_a_patience_lasts_until_it_is_armed_again(bench: Bench) -> None:
    watchdog = bench.armed()
    watchdog.arm(1.0)
    bench.now_s += 1.039
    assert watchdog.check() is Health.OK
    watchdog.arm()
    bench.now_s += 0.041
    assert watchdog.check() is Health.STALE


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


def test_a_stop_that_is_not_confirmed_is_a_failure_and_is_told_again(bench: Bench) -> None:
    told: list[str] = []
    stuck = True

    def tell() -> None:
        told.append(str(watchdog.stop_failure))

    def confirm() -> None:
        if stuck and watchdog.armed is False and told:
            raise DeviceError("it moves")

    watchdog = Watchdog(bench.stop, lambda: bench.now_s, tell, confirm)
    watchdog.self_test()
    watchdog.arm()
    bench.now_s += 1.0
    assert watchdog.check() is Health.STALE
    assert told == ["None", "it moves"]  # the trip at once, the failure when it is known
    watchdog.check()
    assert told == ["None", "it moves"]
    stuck = False
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


REACT_S = 0.05


class Arm:
    """An arm that obeys some means at once, and reports each time that it is asked."""

    def __init__(self, obeys: str = "") -> None:
        self.obeys, self.speed_mm_s = obeys, 40.0
        self.used: list[str] = []

    def means(self, name: str) -> Means:
        def use() -> None:
            self.used.append(name)
            if name == self.obeys:
                self.speed_mm_s = 0.0

        return Means(name, use, REACT_S)

    def report(self) -> Report:
        return Report(time.monotonic(), self.speed_mm_s)


def test_a_thread_that_is_held_up_while_it_asks_does_not_take_a_resting_arm_for_a_silent_one() -> (
    None
):
    """The clock was read after the report: a hold-up of 60 ms made an arm at rest be protected."""
    arm, clock_s = Arm("gentle"), 0.0

    def report() -> Report:
        nonlocal clock_s
        at_s = clock_s
        clock_s += 1.2 * REACT_S  # by another thread, once it has its answer
        return Report(at_s, arm.speed_mm_s)

    means = arm.means("gentle"), arm.means("firm")
    stop = VerifiedStop(means, report, arm.means("last"), lambda: clock_s)
    stop.begin()
    stop.confirm()
    assert arm.used == ["gentle"]


SPINNING_CALL = """
import os, sys, threading, time
from hashlib import pbkdf2_hmac
from spikingtac.stream.real_time import keep_to_one_core, take_precedence
from spikingtac.robot.ur_client import BoundedCalls
calls = BoundedCalls("client")

def spin():  # it lets go of the interpreter, and not of the core
    until_s = time.monotonic() + 0.4
    while time.monotonic() < until_s:
        pbkdf2_hmac("sha256", b"", b"", 20_000)

def look():
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(sys.argv[1])))
    longest_s, woken_s = 0.0, time.monotonic()
    while woken_s < begun_s + 0.5:
        time.sleep(0.002)
        longest_s, woken_s = max(longest_s, time.monotonic() - woken_s), time.monotonic()
    print(longest_s)

if take_precedence(20):
    keep_to_one_core()
    begun_s = time.monotonic()
    looking = threading.Thread(target=look)
    looking.start()
    calls.call(spin, 5.0)
    looking.join()
"""


@pytest.mark.parametrize("priority", [20, 19], ids=["watchdog", "call of another guard"])
def test_a_client_that_waits_without_letting_go_of_the_core_holds_up_nothing(priority: int) -> None:
    """``stopL`` waits so for a controller that pauses: nothing else of a guard ran meanwhile."""
    command = [sys.executable, "-c", SPINNING_CALL, str(priority)]
    done = subprocess.run(command, capture_output=True, check=True, timeout=60.0)
    if not done.stdout:
        pytest.skip("real-time priority is not permitted here")
    assert float(done.stdout) < 0.2


def test_a_means_that_hangs_or_fails_keeps_nothing_up() -> None:
    arm, end = Arm("firm"), threading.Event()
    hangs = Means("hangs", lambda: end.wait(10.0), REACT_S)
    stop = VerifiedStop((hangs, arm.means("firm")), arm.report)
    stop.begin()
    stop.confirm()
    end.set()

    def fails() -> None:
        raise DeviceError("the port is closed")

    broken = VerifiedStop([Means(name, fails, REACT_S) for name in "ab"], Arm().report)
    broken.begin()
    with pytest.raises(DeviceError, match="a: the port is closed; b: the port is closed"):
        broken.confirm()


def test_calls_are_waited_for_within_their_limit_and_never_run_late() -> None:
    end, ran, late = threading.Event(), [], []
    calls = BoundedCalls("client")
    assert calls.call(lambda: 7, 1.0) == 7
    with pytest.raises(DeviceError, match=r"client: .*by zero"):
        calls.call(lambda: 1 // 0, 1.0)
    with pytest.raises(DeviceError, match="no answer within"):
        calls.call(lambda: end.wait(10.0), 0.05, lambda: late.append(1))
    assert calls.running_s() > 0.0
    with pytest.raises(DeviceError, match="no answer within"):
        calls.call(lambda: ran.append(1), 0.05)
    end.set()
    assert calls.call(lambda: 8, 5.0) == 8
    assert (ran, late) == ([], [1])
    assert calls.end(5.0)
