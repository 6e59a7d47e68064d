"""A guard that is told to end stops its arm, and leaves room for others on its core."""

import os
import signal
import socket
import threading

import pytest

from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig
from spikingtac.stream import guard as contact_process


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
