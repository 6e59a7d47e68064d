"""Each example runs, and says what it promises."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import pytest

import spikingtac as st
from stand_ins.small_twin import slides_scene

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    monkeypatch.chdir(tmp_path)


def run(name: str, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> dict[str, Any]:
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    return runpy.run_path(str(EXAMPLES / name), run_name="__main__")


@pytest.mark.parametrize(
    ("name", "promise"),
    [
        ("01_open_events.py", "anomalies: none"),
        ("02_event_rate.py", "pixels sent events"),
        ("03_simulate.py", "events read back"),
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


def test_calibration_finds_the_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # The example as it is, on a smaller sensor than the scene that it names.
    monkeypatch.setattr(st, "load_scene", lambda name: {"bootstrap": slides_scene()}[name])
    found = run("05_calibrate.py", monkeypatch)
    assert "4 x 4 markers" in capsys.readouterr().out
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
