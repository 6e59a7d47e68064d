"""Pictures of the front page are what their commands make today."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest
from PIL import Image

from spikingtac.cli.main import main
from stand_ins.pictures import MOST_DIFFERENT_CELLS, different_cells

PROJECT = Path(__file__).resolve().parents[2]
IMAGES = PROJECT / "docs" / "images"


@pytest.mark.slow
def test_truth_and_track(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    made = tmp_path / "truth_and_track.png"
    monkeypatch.setattr(sys, "argv", ["04_truth_and_track.py", str(made)])
    runpy.run_path(str(PROJECT / "examples" / "04_truth_and_track.py"), run_name="__main__")
    assert different_cells(made, IMAGES / made.name) < MOST_DIFFERENT_CELLS


@pytest.mark.slow
def test_the_summary(tmp_path: Path) -> None:
    made = tmp_path / "demo.png"
    assert main(["view", "demo", "--seed", "1", "--seconds", "12", "--export", str(made)]) == 0
    assert different_cells(made, IMAGES / made.name) < MOST_DIFFERENT_CELLS


@pytest.mark.slow
def test_the_animation(tmp_path: Path) -> None:
    made = tmp_path / "demo.gif"  # the first third of 4.2 s
    assert main(["view", "demo", "--seed", "1", "--seconds", "1.4", "--export", str(made)]) == 0
    with Image.open(made) as now, Image.open(IMAGES / "demo.gif") as then:
        assert 3 * now.n_frames == then.n_frames
        frames = now.n_frames
    for frame in (0, frames // 2, frames - 1):
        assert different_cells(made, IMAGES / "demo.gif", frame) < MOST_DIFFERENT_CELLS, frame
