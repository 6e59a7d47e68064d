"""A stop is watched by the reported speed, on arms that obey one means and not another."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import pytest

from spikingtac.errors import DeviceError
from spikingtac.robot.ur_client import BoundedCalls
from spikingtac.robot.ur_stop import Means, Report, StopConfig, VerifiedStop

CONFIG = StopConfig(react_s=(0.05, 0.05), confirm_s=0.01)


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

        return Means(name, use)

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
        clock_s += 1.2 * CONFIG.react_s[0]  # by another thread, once it has its answer
        return Report(at_s, arm.speed_mm_s)

    means = arm.means("gentle"), arm.means("firm")
    stop = VerifiedStop(means, report, CONFIG, arm.means("last"), lambda: clock_s)
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
    hangs = Means("hangs", lambda: end.wait(10.0))
    stop = VerifiedStop((hangs, arm.means("firm")), arm.report, CONFIG)
    stop.begin()
    stop.confirm()
    end.set()

    def fails() -> None:
        raise DeviceError("the port is closed")

    broken = VerifiedStop((Means("a", fails), Means("b", fails)), Arm().report, CONFIG)
    broken.begin()
    with pytest.raises(DeviceError, match="a: the port is closed; b: the port is closed"):
        broken.confirm()


def test_calls_are_waited_for_within_their_limit_and_never_run_late() -> None:
    end, ran, late = threading.Event(), [], []
    calls = BoundedCalls("client")
    assert calls.call(lambda: 7, 1.0) == 7
    with pytest.raises(DeviceError, match="client: broken"):
        calls.call(lambda: _raise(RuntimeError("broken")), 1.0)
    with pytest.raises(DeviceError, match="no answer within"):
        calls.call(lambda: end.wait(10.0), 0.05, lambda: late.append(1))
    assert calls.running_s() > 0.0
    with pytest.raises(DeviceError, match="no answer within"):
        calls.call(lambda: ran.append(1), 0.05)
    end.set()
    assert calls.call(lambda: 8, 5.0) == 8
    assert (ran, late) == ([], [1])
    assert calls.end(5.0)


def _raise(error: Exception) -> None:
    raise error
