"""Before the watch begins the guard takes its precedence, and with it a core of its own."""

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
