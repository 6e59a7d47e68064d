"""Each example runs, and says what it promises."""

import runpy
import sys
from pathlib import Path
from typing import Any

import pytest

import spikingtac as st
from spikingtac.sim import catalog
from stand_ins.small_twin import SMALLEST, slides_scene

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    monkeypatch.chdir(tmp_path)


def run(name: str, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> dict[str, Any]:
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    return runpy.run_path(str(EXAMPLES / name), run_name="__main__")


@pytest.fixture
def smaller_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let an example run as it is, on a smaller sensor than that of the scenes that it names."""
    smaller, scenes = slides_scene(SMALLEST, slides=3), catalog.scene_names()
    monkeypatch.setattr(st, "load_scene", lambda name: dict.fromkeys(scenes, smaller)[name])


@pytest.mark.parametrize(
    ("name", "promise"),
    [
        ("01_open_events.py", "anomalies: none"),
        ("02_event_rate.py", "pixels sent events"),
        ("07_find_contacts.py", "contact at"),
        ("09_close_a_loop.py", "commands, from"),
        ("10_your_own_tracker.py", "64 markers"),
        ("11_many_fingers.py", "index: ended, 500 frames"),
    ],
)
def test_an_example_says_what_it_promises(
    name: str, promise: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run(name, monkeypatch)
    assert promise in capsys.readouterr().out


@pytest.mark.usefixtures("smaller_sensor")
def test_a_scene_is_simulated_calibrated_and_tracked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run("03_simulate.py", monkeypatch)
    run("04_truth_and_track.py", monkeypatch)
    found = run("05_calibrate.py", monkeypatch)
    said = capsys.readouterr().out
    assert "events read back" in said
    assert "3 x 3 markers" in said
    assert found["apart_px"].max() < 0.3
    assert (tmp_path / "calibration.json").is_file()
    assert (tmp_path / "truth_and_track.png").read_bytes().startswith(b"\x89PNG")


def test_tracks_become_a_figure_and_presets_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run("06_tracks_to_figure.py", monkeypatch)
    assert (tmp_path / "field.pdf").read_bytes().startswith(b"%PDF")
    run("08_compare_presets.py", monkeypatch, "fast")
    said = capsys.readouterr().out
    assert 0.0 < float(said.split("mean ")[-1].split(" px")[0]) < 0.5
