"""The verbs ``experiment`` and ``bench``: what they refuse, and how."""

import json
from pathlib import Path

import pytest

from spikingtac.cli.main import main


def test_an_unknown_experiment_is_refused_with_the_nearest_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["experiment", "point-trackng", "-o", str(tmp_path / "run")]) == 2
    assert "did you mean 'point-tracking'" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_an_unknown_method_is_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    words = ["experiment", "point-tracking", "-o", str(folder), "--methods", "defualt"]
    assert main(words) == 2
    assert "did you mean 'default'" in capsys.readouterr().err
    assert not folder.exists()


def test_results_of_other_settings_are_never_mixed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"experiment": "point-tracking", "seeds": 5}))
    words = ["experiment", "point-tracking", "-o", str(folder), "--quick", "--resume"]
    assert main(words) == 2
    assert "never mixed" in capsys.readouterr().err


def test_bench_refuses_a_folder_that_holds_something_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert main(["bench", "throughput", "-o", str(tmp_path)]) == 2
    assert "not empty" in capsys.readouterr().err
