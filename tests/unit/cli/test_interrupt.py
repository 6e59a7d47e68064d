"""How a verb ends and keeps time: --realtime is for cameras, and SIGTERM brakes an arm."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli.main import main
from spikingtac.cli.sources import EXIT_TERMINATED, ended_by_sigterm
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


def test_the_page_takes_one_camera(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "udp:7777", "--second", "udp:7778", "--realtime"]) == 2
    assert "--realtime takes one camera" in capsys.readouterr().err


def told_to_end(closed: list[str]) -> None:
    with ended_by_sigterm(), contextlib.ExitStack() as stack:
        stack.callback(lambda: closed.append("arm"))
        os.kill(os.getpid(), signal.SIGTERM)
        threading.Event().wait(10.0)


def test_sigterm_closes_what_was_opened() -> None:
    former, closed = signal.getsignal(signal.SIGTERM), []
    with pytest.raises(SystemExit) as ended:
        told_to_end(closed)
    assert ended.value.code == EXIT_TERMINATED
    assert closed == ["arm"]
    assert signal.getsignal(signal.SIGTERM) is former
