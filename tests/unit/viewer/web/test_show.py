"""The start of a showing: patience with a slow machine, and none with a dead session."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from spikingtac.errors import DeviceError
from spikingtac.viewer.session.wire import encode
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
    module._SessionMonitor(session, None, said.append).await_view()
    return clock, said


def test_a_slow_machine_may_compile_for_minutes_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, said = waited(monkeypatch, greets_s=400.0)
    assert clock.now_s >= 400.0
    assert len(said) == 24  # every 15 s, looked at once a second
    assert "compiles kernels" in said[0]
    assert "(16 s so far)" in said[0]


class Calibrating:
    """A session whose markers are learned after its second frame."""

    alive = True
    frames = 0

    def greeting(self, after: int) -> tuple[int, bytes] | None:
        number = 1 if self.frames < 2 else 2
        markers = [] if number == 1 else [[1.0, 2.0]] * 3
        document = json.dumps({"reference_px": markers}).encode()
        return (number, document) if number > after else None

    def frame(self, after: int) -> tuple[int, bytes] | None:
        self.frames += 1
        meta = {"t_us": self.frames, "t_start_us": 0, "events_per_s": 1}
        placed = np.full((3, 2), 5.0, np.float32)
        arrays = {"position_px": placed, "detected_px": placed, "held": np.zeros(3, np.uint8)}
        return self.frames, encode(meta, arrays if self.frames > 2 else {})


def test_markers_that_are_learned_meanwhile_are_in_the_record() -> None:
    session: Any = Calibrating()
    monitor = module._SessionMonitor(session, None, print)
    for _ in range(6):
        assert monitor.poll()
    assert [row.moved_px.tolist() for row in monitor.record._rows] == [[5.0] * 3] * len(
        monitor.record._rows
    )
    assert monitor.record._rows


class Reopening(Calibrating):
    """A session whose page opens another recording after its third frame."""

    def greeting(self, after: int) -> tuple[int, bytes] | None:
        number = 1 if self.frames < 4 else 2
        document = {"reference_px": [[1.0, 2.0]] * 3, "opened": f"recording {number}"}
        return (number, json.dumps(document).encode()) if number > after else None


def test_the_record_is_of_the_recording_that_is_shown_in_the_end() -> None:
    session: Any = Reopening()
    monitor = module._SessionMonitor(session, None, print)
    while session.frames < 5:
        assert monitor.poll()
    first = monitor.record
    for _ in range(3):
        assert monitor.poll()
    assert monitor.record is first
    assert first.number == session.frames
    assert min(row.t_s for row in first._rows) * 1e6 >= 5


def test_a_quick_start_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    assert waited(monkeypatch, greets_s=3.0)[1] == []


@pytest.mark.parametrize("times", [{"greets_s": 90.0, "dies_s": 30.0}, {"greets_s": 1e9}])
def test_a_dead_or_hanging_session_is_an_error(
    monkeypatch: pytest.MonkeyPatch, times: dict[str, float]
) -> None:
    with pytest.raises(DeviceError, match=r"ended|did not start"):
        waited(monkeypatch, **times)
