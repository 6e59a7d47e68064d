"""``spikingtac guard``: a contact ends it well, a fault with an error; the arm stops in both."""

import os
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from spikingtac.cli.verbs import guard
from spikingtac.errors import DeviceError
from spikingtac.events.evt.encode import Evt2Encoder
from spikingtac.events.evt.raw import format_header
from spikingtac.robot.guard import ContactProcess
from spikingtac.robot.guard_loop import ContactLoop, stream_arrivals
from spikingtac.robot.watchdog import Watchdog
from spikingtac.types import EventPacket
from stand_ins.guarded import SLOWED, NotingArm, detector, paced, stops
from stand_ins.live import BurstDetector
from stand_ins.moving_rims import PERIOD_US, SIZE, calibration, windows
from stand_ins.piped_camera import PipedCamera
from stand_ins.random_packets import save_events
from stand_ins.verbs import Verbs
from stand_ins.waiting import SLACK_S

pytestmark = pytest.mark.waits

CALM = partial(Watchdog, stale_s=2.0, backlog_s=60.0)  # a busy machine is neither
WIDE = (320, 320)
TOLD_S = 0.2  # Longest time until a guard that hangs is told, s.
TOUCH = 300  # Window at which something happens: 1.5 s after the stream was opened.


@pytest.fixture
def words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setattr(guard.events, "is_stream", lambda path: True)
    files = ["--events", "pipe", "--calibration", "finger.json", "--quiet", "quiet.raw"]
    return ["guard", "--arm", "192.0.2.1", *files]


def watch(stream: dict[str, int], notes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the verb guard an arm that notes its stops, with a stream in slow real time."""
    arm, source = partial(NotingArm, notes=str(notes)), partial(paced, **stream)
    monkeypatch.setattr(guard, "start", lambda args: ContactProcess(source, detector, arm, CALM))
    monkeypatch.setattr(guard, "SILENCE_S", 60.0)  # the watchdog is patient here, too


@pytest.mark.parametrize(
    ("stream", "code"),
    [({"touch": TOUCH}, 0), ({"end": TOUCH}, 3), ({"stall": TOUCH}, 3)],
    ids=["contact", "end of stream", "stall"],
)
def test_contact_and_fault_stop_the_arm(
    stream: dict[str, int], code: int, words: list[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, verbs: Verbs,
) -> None:  # fmt: skip
    notes = tmp_path / "stops"
    watch(stream, notes, monkeypatch)
    summary = verbs.told(*words, code=code)
    # The self-test, and the contact or the fault; a loop that hangs is told to end: one more.
    assert len(stops(notes)) == (3 if "stall" in stream else 2)
    if code == 0:
        first_us = TOUCH * SLOWED * PERIOD_US
        assert first_us < summary["contact"]["t_us"] <= first_us + 4 * SLOWED * PERIOD_US
        assert summary["health"] == "ok"
        assert 0.0 <= summary["latency"]["decision_us"] < SLACK_S * 1e6
    else:
        told = "no heartbeat" if "stall" in stream else "the event stream ended"
        assert told in summary["error"]


def test_files_that_cannot_be_learned_from_are_refused_before_the_arm_is_connected(
    tmp_path: Path, verbs: Verbs
) -> None:
    pipe, finger, quiet = (tmp_path / name for name in ("camera", "finger.json", "quiet.npz"))
    pipe.write_bytes(b"")
    words = ["guard", "--arm", "192.0.2.1", "--events", pipe, "--calibration", finger]
    words += ["--quiet", quiet]
    assert "must be a camera's named pipe" in verbs.said(*words, code=2)
    pipe.unlink()
    os.mkfifo(pipe)
    assert "there is no file" in verbs.said(*words, code=1)
    save_events(quiet, EventPacket.empty(0, 1_000, (SIZE[0] + 10, SIZE[1])))
    assert "cannot read the calibration" in verbs.said(*words, code=1)
    calibration().save(finger)
    assert "the calibration is for" in verbs.said(*words, code=1)
    save_events(quiet, EventPacket.empty(0, 1_000, SIZE))
    assert "nothing was stopped: the recording holds no events" in verbs.said(*words, code=1)


def test_the_detector_learns_from_the_quiet_recording(tmp_path: Path) -> None:
    calibration().save(tmp_path / "finger.json")
    quiet = save_events(tmp_path / "quiet.npz", *windows(300, seed=1))
    paths = str(tmp_path / "finger.json"), str(quiet)
    learnt = guard.learnt_detector("event_count", *paths, 1.0)
    assert all(learnt.update(window) is None for window in windows(20, seed=2, first=300))


def test_a_guard_that_hangs_is_told_in_a_fifth_of_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[float, str]] = []
    monkeypatch.setattr(guard, "remark", lambda text: told.append((time.monotonic(), text)))
    state = {"phase": "ready", "at_s": time.monotonic(), "precedes": True}
    process: Any = SimpleNamespace(alive=lambda: True, status=lambda: state)
    with pytest.raises(DeviceError, match="see whether the arm stands"):
        guard._wait(process)
    at_s = next(at_s for at_s, text in told if "does not answer" in text)
    assert at_s - state["at_s"] < TOLD_S


def test_what_is_waited_for_is_told_and_no_arm_is_said_to_have_stopped() -> None:
    waiting = {"phase": "starting", "reason": "the camera's events"}
    assert list(guard._news(waiting, 3.0)) == ["waiting for the camera's events"]
    leapt = {"phase": "ready", "precedes": True, "leaps": 1}
    assert "the sensor's clock leapt ahead, 1 times so far" in guard._news(leapt, 0.0)
    told = guard.failure_text({"connected": False, "reason": "no controller"})
    assert told == "no arm was reached, nothing was stopped: no controller"


def events_of(from_s: float, seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, 400_000, 4_000)) + round(from_s * 1e6)
    x, y = rng.integers(0, 320, (2, len(t))).astype(np.uint16)
    return Evt2Encoder().encode(t, x, y, x > y).tobytes()


GARBAGE = np.random.default_rng(0).bytes(6_001)


@pytest.mark.parametrize(
    ("between", "then_s", "kinds"),
    [
        (b"", 10.4 - 1.0, {"time_reset"}),
        (b"", 10.4 - 0.3, {"time_reset"}),
        (GARBAGE, 10.4, {"garbage", "resynchronised", "unknown_word"}),
    ],
)
def test_leaps_back_and_garbage_are_counted_and_told(
    between: bytes, then_s: float, kinds: set[str], tmp_path: Path
) -> None:
    data = format_header("evt2", WIDE) + events_of(10.0, 0) + between + events_of(then_s, 1)
    PipedCamera(tmp_path / "pipe", data, lasting_s=0.8, pieces=200)
    calm = BurstDetector()
    calm.update = lambda window: None  # type: ignore[method-assign]
    loop = ContactLoop(calm, Watchdog(lambda: None, time.monotonic), lambda: None)
    for arrival in stream_arrivals(tmp_path / "pipe"):
        loop._process(arrival)
    news = guard._news({**loop.report(), "phase": "ready", "precedes": True}, 0.0)
    assert {text.split()[2] for text in news if "the stream:" in text} & kinds
