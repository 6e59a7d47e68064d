"""The verb ``design`` without the solid modeller: figures, checks, refusals."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from types import ModuleType

import pytest

from spikingtac.cli.main import main
from spikingtac_hardware.parameters.design import names


def test_it_lists_the_designs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition("  ")[0] for line in lines] == list(names())
    assert main(["design", "--list", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["designs"]) == list(names())


def test_figures_and_checks_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["design"] == "paper-size"
    assert found["figures"]["size_mm"] == [22.0, 22.0, 19.0]
    assert all(check["passed"] for check in found["checks"])


def test_figures_and_checks_as_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "round-fingertip"]) == 0
    shown = capsys.readouterr().out
    assert "px_per_mm" in shown
    assert "checks passed" in shown
    assert "needed" in shown


def test_a_bad_design_gets_its_reasons(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text('based_on = "paper-size"\n[skin]\ngel_mm = 8.65\n')
    assert main(["design", str(bad)]) == 2
    assert "the gel of 8.65 mm leaves 0.4 mm to the lens; needed 1.0" in capsys.readouterr().err


def test_files_need_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = importlib.import_module

    def without_modeller(name: str, package: str | None = None) -> ModuleType:
        if name == "build123d":
            raise ImportError(name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", without_modeller)
    assert main(["design", "-o", str(tmp_path / "sensor")]) == 3
    assert "pip install 'spikingtac[design]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_design_is_not_replaced_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "figures.json").write_text("{}")
    assert main(["design", "-o", str(tmp_path)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main(["design", "-o", str(tmp_path / "figures.json")]) == 2
    assert "is a file" in capsys.readouterr().err
