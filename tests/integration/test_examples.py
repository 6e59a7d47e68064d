"""Each example runs, and says what it promises."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import pytest

import spikingtac as st
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


def on_a_smaller_sensor(scene: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let an example run as it is, on a smaller sensor than the scene that it names."""
    st.load_scene(scene)  # there is one of that name
    smaller = slides_scene(SMALLEST, slides=3)
    monkeypatch.setattr(st, "load_scene", lambda name: {scene: smaller}[name])


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
    name: str,
    promise: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run(name, monkeypatch)
    assert promise in capsys.readouterr().out


def test_a_simulated_scene_is_told_and_read_back(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    on_a_smaller_sensor("finger-slides", monkeypatch)
    run("03_simulate.py", monkeypatch)
    assert "events read back" in capsys.readouterr().out


def test_calibration_finds_the_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    on_a_smaller_sensor("bootstrap", monkeypatch)
    found = run("05_calibrate.py", monkeypatch)
    assert "3 x 3 markers" in capsys.readouterr().out
    assert found["apart_px"].max() < 0.3
    assert (tmp_path / "calibration.json").is_file()


def test_tracks_become_a_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run("06_tracks_to_figure.py", monkeypatch)
    assert (tmp_path / "field.pdf").read_bytes().startswith(b"%PDF")


def test_presets_are_compared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run("08_compare_presets.py", monkeypatch, "fast")
    said = capsys.readouterr().out
    assert 0.0 < float(said.split("mean ")[1].split(" px")[0]) < 0.5
