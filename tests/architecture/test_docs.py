"""Code in the documentation runs, links lead somewhere, and every verb is described."""

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

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
    from spikingtac.sim.catalog import load_scene
    from spikingtac.sim.render import simulate
    from spikingtac.sim.source import SceneSource

    folder, scene = tmp_path_factory.mktemp("named"), load_scene("finger-torsion")
    at_rest = SceneSource(scene)
    Calibration(
        reference_px=np.asarray(at_rest.reference_px),
        radius_px=np.asarray(at_rest.radius_px),
        grid=scene.skin.grid,
        size=scene.size,
        step_on=0.14,
        step_off=0.14,
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
    python = text[text.index("## In ten lines") :].split("```")[1]
    used = set(re.findall(r'(?:load|track)\("([^"]+)"', python)) - {"default"}
    assert used
    assert used <= made
    assert text.index("## From the command line") < text.index("## In ten lines")


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


def test_the_reference_pages_are_those_of_the_code() -> None:
    script = PROJECT / "scripts" / "reference_pages.py"
    done = subprocess.run([sys.executable, script, "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_every_verb_and_public_name_has_its_text() -> None:
    """A section without any text stands for a missing docstring."""
    for name in ("cli.md", "api.md"):
        text = (PROJECT / "docs" / "reference" / name).read_text(encoding="utf-8")
        sections = re.split(r"^## ", text, flags=re.M)[1:]
        assert len(sections) > 20
        bare = [part.split()[0] for part in sections if len(part.split()) < 8]
        assert bare == []
        assert [line for line in text.splitlines() if re.match(r"- `.*: *$", line)] == []
