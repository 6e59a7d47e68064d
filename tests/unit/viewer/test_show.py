"""The start of a showing: patience with a slow machine, and none with a dead session."""

from __future__ import annotations

from typing import Any

import pytest

from spikingtac.errors import DeviceError
from spikingtac.viewer.web import show as module


class Clock:
    now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


class Starting:
    """A session that is alive up to a time and greets at another."""

    def __init__(self, clock: Clock, greets_s: float, dies_s: float = float("inf")) -> None:
        self._clock, self._greets_s, self._dies_s = clock, greets_s, dies_s

    @property
    def alive(self) -> bool:
        return self._clock.now_s < self._dies_s

    def greeting(self, after: int) -> tuple[int, bytes] | None:
        return (1, b"{}") if self._clock.now_s >= self._greets_s else None

    def require_alive(self) -> None:
        if not self.alive:
            raise DeviceError("the session's process ended")


def waited(monkeypatch: pytest.MonkeyPatch, **times: float) -> tuple[Clock, list[str]]:
    clock, said = Clock(), []
    monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(module, "WAIT_S", 1.0)
    session: Any = Starting(clock, **times)
    module.Monitor(session, None, said.append).await_view()
    return clock, said


def test_a_slow_machine_may_compile_for_minutes_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, said = waited(monkeypatch, greets_s=400.0)
    assert clock.now_s >= 400.0
    assert len(said) == 24  # every 15 s, looked at once a second
    assert "compiles kernels" in said[0]
    assert "(16 s so far)" in said[0]


@pytest.mark.parametrize("times", [{"greets_s": 90.0, "dies_s": 30.0}, {"greets_s": 1e9}])
def test_a_dead_or_hanging_session_is_an_error(
    monkeypatch: pytest.MonkeyPatch, times: dict[str, float]
) -> None:
    with pytest.raises(DeviceError, match=r"ended|did not start"):
        waited(monkeypatch, **times)
