"""A camera behind a pipe: tracked, watched, shown, and guarding an arm, as its events come."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from spikingtac import robot
from spikingtac.stream.reader import LiveSource
from spikingtac.tracks import Tracks
from spikingtac.viewer.calibrating import SaveTarget
from spikingtac.viewer.opening import open_view
from stand_ins.guarded import NotingArm, stops
from stand_ins.moving_rims import calibration, windows
from stand_ins.piped_camera import PipedCamera
from stand_ins.random_packets import save_events
from stand_ins.verbs import Verbs

pytestmark = pytest.mark.waits

COMMAND = Path(sys.executable).with_name("spikingtac")
SLOWLY = "--rate-hz", "200"
TOUCH_MS = 400

# How long a camera of 2 s is shown: a machine that compiles meanwhile is given more.
LONGER_AND_LONGER_S = (2.5, 8.0, 20.0)


def moving(path: Path, count: int, seed: int, touch_ms: int = 1 << 30) -> Path:
    """Write windows of the small sensor, whose markers move from ``touch_ms`` on."""

    def speed(number: int) -> tuple[float, float]:
        return (0.1, 0.0) if number >= touch_ms else (0.0, 0.0)

    calibration().save(path.with_name("calibration.json"))
    return save_events(path, *windows(count, seed=seed, speed=speed))


def spikingtac(*arguments: object, stdin: Path | None = None) -> subprocess.CompletedProcess[bytes]:
    command = [str(COMMAND), *map(str, arguments)]
    given = None if stdin is None else stdin.read_bytes()  # through a pipe, not the file itself
    return subprocess.run(command, input=given, capture_output=True, timeout=300)


def test_track_reads_standard_input_as_it_reads_the_file(
    circling: Path, tmp_path: Path, verbs: Verbs
) -> None:
    known = "--calibration", circling / "calibration.json", *SLOWLY
    live, whole = tmp_path / "live.npz", tmp_path / "whole.npz"
    done = spikingtac("track", "-", *known, "-o", live, stdin=circling / "events.raw")
    assert done.returncode == 0, done.stderr
    verbs.said("track", circling / "events.raw", *known, "-o", whole)
    one, other = Tracks.load(live), Tracks.load(whole)
    np.testing.assert_array_equal(one.detected_px, other.detected_px)
    np.testing.assert_array_equal(one.t_us, other.t_us)
    assert one.meta["input_sha256"] is None
    assert other.meta["input_sha256"]


def test_contact_watches_a_stream_with_what_a_quiet_recording_taught(
    tmp_path: Path, verbs: Verbs
) -> None:
    quiet = moving(tmp_path / "quiet.raw", 3000, seed=1)
    live = moving(tmp_path / "live.raw", 800, seed=2, touch_ms=TOUCH_MS)
    known = "--calibration", tmp_path / "calibration.json"
    done = spikingtac("contact", "-", "--quiet", quiet, *known, "--json", stdin=live)
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)["contacts"]
    assert 0 < found["t_us"] - TOUCH_MS * 1000 < 10_000
    assert f"contact at {found['t_us']} us" in done.stderr.decode()
    assert "--quiet" in verbs.said("contact", "-", *known, code=2)


def test_the_page_shows_a_camera(circling: Path, tmp_path: Path) -> None:
    known = "--calibration", circling / "calibration.json", *SLOWLY
    shown = *known, "--headless", "--port", "0", "--json"
    for seconds in LONGER_AND_LONGER_S:  # a cold cache is compiled meanwhile
        (pipe := tmp_path / "live").unlink(missing_ok=True)
        PipedCamera(pipe, (circling / "events.raw").read_bytes(), lasting_s=2.0)
        done = spikingtac("view", pipe, "--seconds", seconds, *shown)
        assert done.returncode == 0, done.stderr
        summary = json.loads(done.stdout)
        if summary["estimates"] > 10 and summary["displacement_max_px"] > 0.1:
            return
    pytest.fail(f"nothing was shown: {summary}")


# A busy machine may fall behind before the camera stalls: that stops the arm as well, and the
# test begins again.
TRIES = 4


def test_a_camera_that_stalls_stops_a_probing_arm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verbs: Verbs
) -> None:
    live = moving(tmp_path / "live.raw", 2000, seed=4)
    notes = tmp_path / "stops"
    monkeypatch.setattr("spikingtac.cli.probe_sites.QUIET_WINDOWS", 300)
    monkeypatch.setattr(robot, "URArm", lambda address: NotingArm(str(notes)))
    finger = "--events", tmp_path / "pipe", "--calibration", tmp_path / "calibration.json"
    given = "probe", "--arm", "192.0.2.1", *finger, "--detector", "event_count"
    for _ in range(TRIES):
        (tmp_path / "pipe").unlink(missing_ok=True)
        notes.unlink(missing_ok=True)
        camera = PipedCamera(tmp_path / "pipe", live.read_bytes(), lasting_s=2.0, pieces=500)
        camera.pause_after(0.6)
        told = verbs.told(*given, code=3)
        camera.go_on.set()
        camera.join()
        assert told["kind"] == "DeviceError"
        assert len(stops(notes)) >= 2  # the self-test, and the stall
        if "overload" not in told["error"]:
            break
    assert "stale" in told["error"]


def test_a_camera_without_a_calibration_shows_its_events() -> None:
    view = open_view("udp:127.0.0.1:0?encoding=evt2&size=320x320", save=SaveTarget())
    assert isinstance(view.source, LiveSource)  # a silent camera holds nothing up
    view.source.close()
    assert view.source.size == (320, 320)
    assert not view.ends
    assert view.calibration.reference_px.shape == (0, 2)
    assert "spikingtac calibrate udp:" in view.desk.shown()[0]["command"]
