"""What a guard does with its precedence: it keeps to a core, and leaves room for others there."""

import os
import signal
import socket
import threading
from typing import Any, cast

import pytest

from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig
from spikingtac.stream import guard as contact_process
from spikingtac.stream import real_time
from spikingtac.stream.guard import STATUS_BYTES, GuardStatus
from spikingtac.stream.guard_loop import ContactLoop
from spikingtac.stream.real_time import GUARD_PRIORITY, PRIORITY
from spikingtac.stream.ring import SharedRing
from stand_ins.guarded import NotingArm


@pytest.mark.parametrize("permitted", [True, False])
def test_the_guard_keeps_to_a_core_only_where_it_precedes(
    monkeypatch: pytest.MonkeyPatch, permitted: bool, tmp_path: Any
) -> None:
    asked: list[Any] = []

    def take(priority: int) -> bool:
        asked.append(priority)
        return permitted

    monkeypatch.setattr(real_time, "take_precedence", take)
    monkeypatch.setattr(real_time, "keep_to_one_core", lambda: asked.append("core"))
    arm = NotingArm(str(tmp_path / "notes"))
    watchdog = Watchdog(WatchdogConfig(), arm.stop, lambda: 0.0)
    ring = SharedRing.for_latest(STATUS_BYTES)
    try:
        status = GuardStatus(ring, threading.Event())
        status.rehearse(ContactLoop(cast(Any, None), watchdog, arm.stop), arm)
    finally:
        ring.close()
    assert status.precedes == permitted
    assert asked == [GUARD_PRIORITY, *(["core"] if permitted else [])]
    assert GUARD_PRIORITY > PRIORITY, "a tracker on the same core must not hold it up"


class _ProcessEndedError(Exception):
    """The process has ended."""


def test_stopping_again_and_again_leaves_the_core_to_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Another guard on the core was starved for 4 s: every stop failed at once, without a pause."""
    orders: list[None] = []

    def stop() -> None:
        orders.append(None)
        raise ConnectionError("nobody there")

    def leave(code: int) -> None:
        raise _ProcessEndedError(code)

    period_s, insistence_s = contact_process.INSISTENCE_PERIOD_S, 0.2
    monkeypatch.setattr(contact_process, "INSISTENCE_S", insistence_s)
    monkeypatch.setattr(os, "_exit", leave)
    told, teller = socket.socketpair()
    with told, teller:
        teller.send(bytes([signal.SIGTERM]))
        watchdog = Watchdog(WatchdogConfig(), stop, lambda: 0.0)
        with pytest.raises(_ProcessEndedError):
            contact_process._brake(watchdog, told, threading.Event())
    assert 2 <= len(orders) <= insistence_s / period_s + 2


def test_a_guard_that_has_ended_with_its_arm_at_rest_stops_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The arm's driver was closed by then, and refused the stop again and again for 4 s."""

    def stop() -> None:
        raise AssertionError("the arm is not connected any more")

    monkeypatch.setattr(os, "_exit", lambda code: pytest.fail("it was to let go of the arm first"))
    told, teller = socket.socketpair()
    rests = threading.Event()
    rests.set()
    with told, teller:
        teller.send(bytes([signal.SIGTERM]))
        watchdog = Watchdog(WatchdogConfig(), stop, lambda: 0.0)
        contact_process._brake(watchdog, told, rests)
    assert watchdog.health is Health.OK
