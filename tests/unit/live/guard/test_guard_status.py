"""What a guard does with its precedence: it keeps to a core, and leaves room for others there."""

import os
import signal
import socket
from typing import Any, cast

import pytest

from spikingtac.live.guard import contact_process
from spikingtac.live.guard.contact_loop import ContactLoop
from spikingtac.live.guard.contact_process import STATUS_BYTES, GuardStatus
from spikingtac.live.real_time import GUARD_PRIORITY, PRIORITY
from spikingtac.live.ring import SharedRing
from spikingtac.robot.watchdog import Watchdog, WatchdogConfig
from stand_ins.guarded import NotingArm


@pytest.mark.parametrize("permitted", [True, False])
def test_the_guard_keeps_to_a_core_only_where_it_precedes(
    monkeypatch: pytest.MonkeyPatch, permitted: bool, tmp_path: Any
) -> None:
    asked: list[Any] = []

    def take(priority: int) -> bool:
        asked.append(priority)
        return permitted

    monkeypatch.setattr(contact_process, "take_precedence", take)
    monkeypatch.setattr(contact_process, "keep_to_one_core", lambda: asked.append("core"))
    arm = NotingArm(str(tmp_path / "notes"))
    watchdog = Watchdog(WatchdogConfig(), arm.stop, lambda: 0.0)
    ring = SharedRing.create(STATUS_BYTES)
    try:
        status = GuardStatus(ring)
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
            contact_process._brake(watchdog, told)
    assert 2 <= len(orders) <= insistence_s / period_s + 2
