"""A gel whose edges give fewer events than at the calibration is told of by track and touch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli.main import main
from spikingtac.sim.catalog import load_scene
from spikingtac.sim.render import simulate

# What an event stands for, as counted: an edge gives six (a threshold is 0.14 of the swing, and
# the first and the last part of one give none).
STEP = 0.17


@pytest.fixture(scope="module")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("slides") / "one"
    simulate(load_scene("train-slides"), folder, seed=0, duration_s=1.6)
    return folder


@pytest.fixture(autouse=True)
def few_markers_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """In 1.6 s not many markers move far."""
    monkeypatch.setattr("spikingtac.touch.ageing.LEAST_MARKERS", 2)


def calibrated(recording: Path, path: Path, step: float) -> Path:
    with np.load(recording / "truth.npz") as truth:
        reference_px, radius_px = truth["reference_px"], truth["radius_px"]
    Calibration(
        reference_px=reference_px, radius_px=radius_px, grid=(8, 8), size=(320, 320),
        step_on=step, step_off=step,
    ).save(path)  # fmt: skip
    return path


def tracked(
    recording: Path, step: float, folder: Path, capsys: pytest.CaptureFixture[str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    calibration = calibrated(recording, folder / "calibration.json", step)
    line = ["track", str(recording), "--calibration", str(calibration)]
    assert main([*line, "-o", str(folder / "tracks.npz"), "--json"]) == 0
    with np.load(folder / "tracks.npz") as tracks:
        return json.loads(capsys.readouterr().out), json.loads(str(tracks["meta"]))


def test_a_fresh_gel_is_not_warned_of(
    slides: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary, meta = tracked(slides, STEP, tmp_path, capsys)
    assert 0.85 < summary["swing"] < 1.15
    assert summary["ageing"] is None
    assert meta["swing"] == summary["swing"]


def test_a_faded_gel_is_warned_of(
    slides: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary, meta = tracked(slides, 0.6 * STEP, tmp_path, capsys)  # it once gave more events
    assert summary["swing"] < 0.75
    assert "calibrate again" in summary["ageing"]
    assert meta["ageing"] == summary["ageing"]


def test_the_warning_stands_beside_the_table(
    slides: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = calibrated(slides, tmp_path / "calibration.json", 0.6 * STEP)
    line = ["track", str(slides), "--calibration", str(calibration)]
    assert main([*line, "-o", str(tmp_path / "tracks.npz")]) == 0
    assert "warning: an edge gives" in capsys.readouterr().err
