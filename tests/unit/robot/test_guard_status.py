"""A guard that is told to end stops its arm, and leaves room for others on its core."""

import os
import signal
import socket
import threading

import pytest

from spikingtac.robot import guard
from spikingtac.robot.watchdog import Health, Watchdog

INSISTENCE_S = 0.2


@pytest.mark.parametrize("rests", [False, True])
def test_a_guard_that_is_told_to_end_stops_again_with_pauses_unless_its_arm_rests(
    rests: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every stop fails at once: without a pause, another guard on the core starved for 4 s."""
    orders: list[None] = []

    def stop() -> None:
        orders.append(None)
        raise ConnectionError("nobody there")

    def leave(code: int) -> None:
        raise InterruptedError(code)

    monkeypatch.setattr(guard, "INSISTENCE_S", INSISTENCE_S)
    monkeypatch.setattr(os, "_exit", leave)
    watchdog, ended = Watchdog(stop, lambda: 0.0), threading.Event()
    told, teller = socket.socketpair()
    with told, teller:
        teller.send(bytes([signal.SIGTERM]))
        if rests:  # the arm's driver is closed by then
            ended.set()
            guard._brake(watchdog, told, ended)
            assert (watchdog.health, orders) == (Health.OK, [])
            return
        with pytest.raises(InterruptedError):
            guard._brake(watchdog, told, ended)
    assert 2 <= len(orders) <= INSISTENCE_S / guard.INSISTENCE_PERIOD_S + 2
