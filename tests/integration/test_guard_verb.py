"""``spikingtac guard``: a contact ends it well, a fault with an error; the arm stops in both."""

import json
import os
from pathlib import Path

import pytest

from spikingtac.cli.main import main
from spikingtac.cli.verbs import guard
from spikingtac.events.create import create_events
from spikingtac.robot.watchdog import WatchdogConfig
from spikingtac.stream.guard import ContactProcess
from spikingtac.stream.host import Factory
from spikingtac.types import EventPacket
from stand_ins.guarded import SLOWED, NotingArm, detector, paced, stops
from stand_ins.moving_rims import PERIOD_US, SIZE, calibration, windows

pytestmark = pytest.mark.waits

CALM = WatchdogConfig(stale_s=2.0, backlog_s=60.0)  # a busy machine is neither
TOUCH = 300  # Window at which something happens: 1.5 s after the stream was opened.


@pytest.fixture
def words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setattr(guard, "is_stream", lambda path: True)
    files = ["--events", "pipe", "--calibration", "finger.json", "--quiet", "quiet.raw"]
    return ["guard", "--arm", "192.0.2.1", *files, "--json"]


def watch(stream: dict[str, int], notes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the verb guard an arm that notes its stops, with a stream in slow real time."""

    def start(args: guard.Args) -> ContactProcess:
        arm = Factory(function=NotingArm, arguments={"notes": str(notes)})
        source = Factory(function=paced, arguments=stream)
        return ContactProcess(source, Factory(function=detector), arm, CALM)

    monkeypatch.setattr(guard, "start", start)
    monkeypatch.setattr(guard, "SILENCE_S", 60.0)  # the watchdog is patient here, too


@pytest.mark.parametrize(
    ("stream", "code"),
    [({"touch": TOUCH}, 0), ({"end": TOUCH}, 3), ({"stall": TOUCH}, 3)],
    ids=["contact", "end of stream", "stall"],
)
def test_contact_and_fault_stop_the_arm(
    stream: dict[str, int],
    code: int,
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    notes = tmp_path / "stops"
    watch(stream, notes, monkeypatch)
    assert main(words) == code
    # The self-test, and the contact or the fault; a loop that hangs is told to end: one more.
    assert len(stops(notes)) == (3 if "stall" in stream else 2)
    summary = json.loads(capsys.readouterr().out)
    if code == 0:
        first_us = TOUCH * SLOWED * PERIOD_US
        assert first_us < summary["contact"]["t_us"] <= first_us + 4 * SLOWED * PERIOD_US
    else:
        told = "no heartbeat" if "stall" in stream else "the event stream ended"
        assert told in summary["error"]


def test_a_recording_is_no_stream(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "events.raw").write_bytes(b"")
    files = ["--calibration", "finger.json", "--quiet", "quiet.raw"]
    recording = str(tmp_path / "events.raw")
    assert main(["guard", "--arm", "192.0.2.1", "--events", recording, *files]) == 2
    assert "must be a camera's named pipe" in capsys.readouterr().err


def test_files_that_cannot_be_learned_from_are_refused_before_the_arm_is_connected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe, finger, quiet = (tmp_path / name for name in ("camera", "finger.json", "quiet.npz"))
    os.mkfifo(pipe)
    words = ["guard", "--arm", "192.0.2.1", "--events", str(pipe), "--calibration", str(finger)]
    assert main([*words, "--quiet", str(quiet)]) == 1
    assert "cannot read the calibration" in capsys.readouterr().err
    calibration().save(finger)
    assert main([*words, "--quiet", str(quiet)]) == 1
    assert "there is no file" in capsys.readouterr().err
    with create_events(quiet, (SIZE[0] + 10, SIZE[1])) as writer:
        writer.write(EventPacket.empty(0, 1_000, (SIZE[0] + 10, SIZE[1])))
    assert main([*words, "--quiet", str(quiet)]) == 1
    assert "the calibration is for" in capsys.readouterr().err


def test_the_detector_learns_from_the_quiet_recording(tmp_path: Path) -> None:
    calibration().save(tmp_path / "finger.json")
    quiet = tmp_path / "quiet.npz"
    with create_events(quiet, SIZE) as writer:
        for window in windows(300, seed=1):
            writer.write(window)
    paths = str(tmp_path / "finger.json"), str(quiet)
    learnt = guard.learnt_detector("event_count", *paths, 1.0)
    assert all(learnt.update(window) is None for window in windows(20, seed=2, first=300))
