"""A recording without a calibration is shown: its events, its figures, and what to do next."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli.main import main
from spikingtac.viewer.hosted import warm_up
from spikingtac.viewer.openers import open_view_or_events
from spikingtac.viewer.session import Session
from stand_ins.viewer import record_circling
from stand_ins.wire import decode


class Kept:
    """A publisher that keeps its last message."""

    message = b""

    def publish(self, message: bytes) -> bool:
        self.message = bytes(message)
        return True


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = record_circling(tmp_path_factory.mktemp("unknown"))
    (folder / "calibration.json").unlink()
    return folder / "events.raw"


def test_its_events_are_shown_with_figures_and_advice(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = open_view_or_events(str(recording))
    warm_up(view)
    frames, greetings = Kept(), Kept()
    session = Session(view, frames, greetings)
    monkeypatch.setattr(session.pacer, "wait", lambda: None)
    for _ in range(20):
        session.step()
    hello = json.loads(greetings.message)
    meta, arrays = decode(frames.message)
    assert hello["reference_px"] == []
    assert hello["controls"] == []
    quality = hello["quality"]
    assert quality["rate_hz"] > 1_000
    assert 0.3 < quality["on_fraction"] < 0.7
    assert quality["hot_pixels"] >= 0
    assert "position_px" not in arrays
    assert np.count_nonzero(arrays["activity"]) > 10
    assert arrays["counts"].sum() > 0
    assert meta["notice"] == ""
    guide = meta["guide"]
    assert guide["state"] == "guide"
    assert guide["command"] == "spikingtac calibrate events.raw -o calibration.json"
    assert guide["advice"]
    assert meta["displacement_max_px"] == 0.0
    session.close()


@pytest.mark.parametrize("other", [("--calibration", "x.json"), ("--export", "x.gif")])
def test_a_calibration_is_either_given_or_made(
    other: tuple[str, str], recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(recording), "--calibrate", *other]) == 2
    assert "--calibrate" in capsys.readouterr().err
