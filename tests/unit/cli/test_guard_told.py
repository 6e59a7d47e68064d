"""What a guard's user is told, and how soon: a guard that hangs, leaps, damage, silence."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.cli.verbs import guard
from spikingtac.errors import DeviceError
from spikingtac.events.evt.encode import Evt2Encoder
from spikingtac.events.evt.header import format_header
from spikingtac.robot.watchdog import Watchdog, WatchdogConfig
from spikingtac.stream.guard_loop import Arrival, ContactLoop, GuardReport, stream_arrivals
from stand_ins.live import BurstDetector
from stand_ins.moving_rims import windows
from stand_ins.piped_camera import PipedCamera

SIZE = (320, 320)
TOLD_S = 0.2


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, str]]:
    found: list[tuple[float, str]] = []
    monkeypatch.setattr(guard, "remark", lambda text: found.append((time.monotonic(), text)))
    return found


class Hanging:
    """A guarding process whose last state is getting old."""

    def __init__(self) -> None:
        self.last_s = time.monotonic()

    def alive(self) -> bool:
        return True

    def status(self) -> dict[str, Any]:
        return {"phase": "ready", "at_s": self.last_s, "precedes": True}


def test_a_guard_that_hangs_is_told_in_a_fifth_of_a_second(told: list[tuple[float, str]]) -> None:
    process = Hanging()
    with pytest.raises(DeviceError, match="see whether the arm stands"):
        guard._wait(process)  # type: ignore[arg-type]
    at_s = next(at_s for at_s, text in told if "does not answer" in text)
    assert at_s - process.last_s < TOLD_S


def quiet_loop() -> ContactLoop:
    watchdog = Watchdog(WatchdogConfig(), lambda: None, time.monotonic)
    detector = BurstDetector()
    detector.update = lambda window: None  # type: ignore[method-assign]
    return ContactLoop(detector, watchdog, lambda: None)


def follow(report: GuardReport) -> None:
    status = {**asdict(report), "phase": "ready", "precedes": True}
    guard._Follower().look(status, 0.0)


@pytest.mark.parametrize("leap_s", [0.3, 0.45])
def test_a_small_leap_ahead_is_counted_and_told(
    leap_s: float, told: list[tuple[float, str]]
) -> None:
    loop = quiet_loop()
    for number, window in enumerate(windows(1_000, seed=0)):
        ahead_s = leap_s if number >= 500 else 0.0
        loop._process(Arrival((window,), 5.0 + window.t_end_us / 1e6 - ahead_s))
    assert loop.report().leaps == 1
    follow(loop.report())
    assert any("leapt ahead" in text for _, text in told)


def words(from_s: float, seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, 400_000, 4_000)) + round(from_s * 1e6)
    x, y = rng.integers(0, 320, (2, len(t))).astype(np.uint16)
    return Evt2Encoder().encode(t, x, y, x > y).tobytes()


@pytest.mark.parametrize(
    ("between", "then_s", "kinds"),
    [
        (b"", 10.4 - 0.3, {"time_reset"}),
        (b"", 10.4 - 1.0, {"time_reset"}),
        (
            np.random.default_rng(0).bytes(6_001),
            10.4,
            {"garbage", "resynchronised", "unknown_word"},
        ),
    ],
    ids=["0.3 s back", "1 s back", "garbage"],
)
def test_leaps_back_and_garbage_are_counted_and_told(
    between: bytes, then_s: float, kinds: set[str], tmp_path: Path, told: list[tuple[float, str]]
) -> None:
    data = format_header("evt2", SIZE) + words(10.0, 0) + between + words(then_s, 1)
    PipedCamera(tmp_path / "pipe", data, lasting_s=0.8, pieces=200)
    loop = quiet_loop()
    for arrival in stream_arrivals(tmp_path / "pipe"):
        loop._process(arrival)
    report = loop.report()
    assert report.losses.keys() & kinds
    follow(report)
    assert {text.split()[2] for _, text in told if "the stream:" in text} & kinds


def test_a_camera_that_sends_nothing_is_told(told: list[tuple[float, str]]) -> None:
    waiting = {"phase": "starting", "reason": "the camera's events"}
    follower = guard._Follower()
    follower.look(waiting, 1.0)
    follower.look(waiting, guard.WAITING_S + 0.1)
    assert [text for _, text in told] == ["waiting for the camera's events"]
