"""The option --realtime: for cameras alone, and what was granted is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli.interrupt import require_live
from spikingtac.cli.main import main
from spikingtac.errors import ConfigError
from spikingtac.events.create import create_events
from spikingtac.types import EventPacket

SIZE = (40, 30)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "short.raw"
    t_us = np.arange(0, 20_000, 50, dtype=np.int64)
    x, y = (np.full(len(t_us), side // 2, np.uint16) for side in SIZE)
    with create_events(path, SIZE) as writer:
        writer.write(EventPacket(x, y, t_us % 100 == 0, t_us, 0, 20_000, SIZE))
    return path


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.json"
    Calibration(
        reference_px=np.array([[20.0, 15.0]]), radius_px=np.array([6.0]), grid=(1, 1), size=SIZE
    ).save(path)
    return path


@pytest.mark.parametrize("verb", ["track", "contact", "view"])
def test_a_recording_has_no_deadlines(
    verb: str, recording: Path, calibration: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [verb, str(recording), "--calibration", str(calibration), "--realtime"]
    assert main(arguments) == 2
    assert "is a recording and has no deadlines" in capsys.readouterr().err


def test_cameras_have_deadlines(recording: Path) -> None:
    require_live(["-", "udp:7777?encoding=evt2&size=320x320"])
    with pytest.raises(ConfigError, match=r"short\.raw"):
        require_live(["-", recording])


def test_the_page_takes_one_camera(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "udp:7777", "--second", "udp:7778", "--realtime"]) == 2
    assert "--realtime takes one camera" in capsys.readouterr().err


@pytest.mark.parametrize("asked", [True, False])
def test_track_asks_before_it_follows(
    asked: bool, recording: Path, calibration: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    module = "spikingtac.cli.track"
    monkeypatch.setattr(f"{module}.require_live", lambda _: calls.append("checked"))
    monkeypatch.setattr(f"{module}.ask_for_real_time", lambda: calls.append("asked"))
    output = recording.with_name("tracks.npz")
    options = ["--calibration", str(calibration), "-o", str(output)]
    assert main(["track", str(recording), *options, *(["--realtime"] if asked else [])]) == 0
    assert calls == (["checked", "asked"] if asked else [])
    assert output.is_file()
