"""From tracks to a figure, a table and a comparison, by the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli.main import main
from stand_ins.tracks import circling_tracks
from stand_ins.viewer import positions_px


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    circling_tracks(px_per_mm=15.5).save(tmp_path / "one.npz")
    circling_tracks(off_px=0.5).save(tmp_path / "other.npz")
    times_us = np.arange(0, 500_001, 1_000)
    truth = np.stack([positions_px(t_us) for t_us in times_us])
    np.savez(tmp_path / "truth.npz", marker_t_us=times_us, marker_px=truth)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert main([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("ending", [".png", ".svg", ".pdf"])
def test_plot_writes_a_figure(
    folder: Path, ending: str, capsys: pytest.CaptureFixture[str]
) -> None:
    output = f"field{ending}"
    found = told(capsys, "plot", "one.npz", "--kind", "field", "--at-s", "0.1", "-o", output)
    assert found["output"] == output
    assert found["displacement_max_mm"] > 0.5
    assert (folder / output).stat().st_size > 1_000
    assert main(["plot", "one.npz", "-o", output]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_compare_gives_the_error_between_tracks_and_to_a_truth(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = told(capsys, "compare", "one.npz", "other.npz", "--plot", "c.png", "--table", "c.csv")
    assert found["difference_mean_px"] == pytest.approx(0.5, abs=1e-3)
    assert found["difference_mean_mm"] == pytest.approx(0.5 / 15.5, abs=1e-4)
    assert (folder / "c.png").is_file()
    assert len((folder / "c.csv").read_text().splitlines()) == 65
    for truth in ("truth.npz", "."):
        assert told(capsys, "compare", "one.npz", truth)["error_mean_px"] < 1e-3
    assert main(["compare", "one.npz", "other.npz"]) == 0
    assert "difference mean " in capsys.readouterr().out


def test_compare_refuses_what_is_neither(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(folder / "x.npz", a=1)
    assert main(["compare", "one.npz", "x.npz"]) == 1
    assert "neither tracks nor a truth" in capsys.readouterr().err
    assert main(["compare", "x.npz", "one.npz"]) == 1
    assert "holds no tracks" in capsys.readouterr().err


def test_info_describes_tracks(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = told(capsys, "info", "one.npz")
    assert (found["format"], found["markers"], found["estimates"]) == ("tracks", 64, 500)
    assert main(["info", "one.npz"]) == 0
    assert "displacement max" in capsys.readouterr().out
