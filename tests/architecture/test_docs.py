"""Code in the documentation runs, links lead somewhere, and every verb is described."""

import dataclasses
import importlib
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli.registry import module_of, verbs
from stand_ins.tracks import circling_tracks

PROJECT = Path(__file__).resolve().parents[2]
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]
MARK = "# runs in the tests"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.S | re.M)
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)")


def blocks() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        for index, code in enumerate(BLOCK.findall(page.read_text(encoding="utf-8"))):
            if code.startswith(MARK):
                yield f"{page.relative_to(PROJECT)}[{index}]", code


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the calibration, the recording and the tracks that the examples name."""
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.sim.scene.catalog import load
    from spikingtac.sim.scene.render import simulate
    from spikingtac.sim.scene.source import SceneSource

    folder, scene = tmp_path_factory.mktemp("named"), load("finger-torsion")
    at_rest = SceneSource(scene)
    Calibration(
        reference_px=np.asarray(at_rest.reference_px),
        radius_px=np.asarray(at_rest.radius_px),
        grid=scene.skin.grid,
        size=scene.size,
    ).save(folder / "left_finger.json")
    simulate(scene, folder / "twist", seed=1, duration_s=1.0)
    for name in ("tracks.npz", "other.npz"):
        circling_tracks(estimates=20).save(folder / name)
    return folder


@pytest.fixture
def beside(named: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of each example's own with copies of these."""
    monkeypatch.chdir(shutil.copytree(named, tmp_path / "beside"))
    return Path.cwd()


@pytest.mark.parametrize("code", [pytest.param(code, id=name) for name, code in blocks()])
def test_code_runs(code: str, beside: Path) -> None:
    exec(compile(code, "documentation", "exec"), {"__name__": "documentation"})


def test_the_readme_example_is_among_them() -> None:
    assert any(name.startswith("README.md") for name, _ in blocks())


def test_the_readme_makes_every_file_before_it_is_used() -> None:
    text = (PROJECT / "README.md").read_text(encoding="utf-8")
    shell = text[text.index("## From the command line") :].split("```")[1]
    made = set(re.findall(r"-o (\S+)", shell))
    python = text[text.index("## In twenty lines") :].split("```")[1]
    used = set(re.findall(r'(?:load|open_events)\("([^"]+)"\)', python)) - {"default"}
    assert used
    assert used <= made
    assert text.index("## From the command line") < text.index("## In twenty lines")


def test_links_lead_somewhere() -> None:
    broken = []
    for page in PAGES:
        targets = LINK.findall(page.read_text(encoding="utf-8"))
        local = [target for target in targets if "://" not in target]
        broken += [
            f"{page.relative_to(PROJECT)}: {target}"
            for target in local
            if not (page.parent / target).exists()
        ]
    assert broken == []


def test_the_readme_holds_the_two_commands() -> None:
    text = (PROJECT / "README.md").read_text(encoding="utf-8")
    first_screen = text.split("\n## ")[0]
    for command in (
        "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/spikingtac demo",
        "python3 -m venv .venv && .venv/bin/pip install -e '.[dev]' && .venv/bin/python -m pytest",
    ):
        assert command in first_screen
    assert "no relation to its authors" in first_screen


def undescribed(verb: str, text: str) -> list[str]:
    """Return the flags of a verb that its section does not name."""
    section = re.search(rf"^## {verb}\n(.*?)(?=^## |\Z)", text, re.S | re.M)
    if section is None:
        return ["the whole section"]
    fields = dataclasses.fields(importlib.import_module(module_of(verb)).Args)
    flags = (f"`--{field.name.replace('_', '-')}`" for field in fields)
    # A positional argument is listed under its name in capitals.
    missing = [flag for flag in flags if flag not in section.group(1)]
    positional = re.findall(r"^\| `[A-Z]", section.group(1), re.M)
    return missing if len(missing) != len(positional) else []


def test_every_verb_is_described_with_its_flags() -> None:
    text = (PROJECT / "docs" / "reference" / "cli.md").read_text(encoding="utf-8")
    found = {verb: undescribed(verb, text) for verb in verbs()}
    assert {verb: missing for verb, missing in found.items() if missing} == {}
    assert undescribed(next(iter(verbs())), text.replace("`--", "`-"))
