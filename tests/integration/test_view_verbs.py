"""``spikingtac view`` and ``spikingtac demo`` without a browser, as on a server."""

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest

from stand_ins.verbs import Verbs

COMMAND = Path(sys.executable).with_name("spikingtac")


def pictured(verbs: Verbs, picture: Path, *words: object) -> dict[str, Any]:
    """Return the summary of a view that ends by itself and writes a picture."""
    summary = verbs.told("view", *words, picture, "--headless")
    assert picture.read_bytes()[1:4] == b"PNG"
    assert "open http" not in verbs.err  # no port is taken
    return summary


def test_demo_headless_ends_by_itself_with_a_summary_and_a_picture(tmp_path: Path) -> None:
    picture = tmp_path / "demo.png"
    words = "demo", "--headless", "--seconds", "1", "--port", "0", "-o", str(picture), "--json"
    done = subprocess.run([COMMAND, *words], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["estimates"] > 10
    assert 0 < summary["error_mean_px"] < 2
    assert picture.read_bytes()[1:4] == b"PNG"


def test_a_recording_ends_where_it_ends_and_events_alone_make_a_picture(
    circling: Path, tmp_path: Path, verbs: Verbs
) -> None:
    picture = tmp_path / "x.png"
    summary = pictured(verbs, picture, circling, "-o")
    assert summary["played_s"] == pytest.approx(0.6, abs=0.02)
    assert summary["estimates"] == pytest.approx(600, abs=12)
    assert summary["calibration"] == str(circling / "calibration.json")
    assert summary["picture"] == str(picture)
    (tmp_path / "events.raw").write_bytes((circling / "events.raw").read_bytes())
    for option in ("-o", "--export"):
        summary = pictured(verbs, tmp_path / f"x{option}.png", tmp_path, option)
        assert (summary["calibration"], summary.get("estimates", 0)) == (None, 0)


def test_a_silent_camera_is_left(
    circling: Path, verbs: Verbs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("spikingtac.stream.reader.SILENT_S", 0.1)
    given = "udp:0", "--seconds", 0.1, "--calibration", circling / "calibration.json"
    assert verbs.told("view", *given, "--headless")["estimates"] == 0
    assert "field" not in verbs.told("foxglove", *given, "--port", 0)["messages"]


def test_ctrl_c_ends_it_quietly(circling: Path) -> None:
    process = subprocess.Popen(
        [COMMAND, "view", str(circling), "--no-browser", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    line = process.stderr.readline()
    assert line.startswith("open http://127.0.0.1:")
    assert httpx.get(line.split()[1], timeout=60).status_code == 200
    process.send_signal(signal.SIGINT)
    out, rest = process.communicate(timeout=120)
    assert process.returncode == 0
    assert "estimates" in out
    assert "Traceback" not in rest
