"""Code of the documentation runs, links and pictures are there, sentences are short.

The pages of the command line and of Python are made from help texts and docstrings, so these are
checked as well.
"""

import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import spikingtac as st
from spikingtac.cli.main import _parsed, function_of, verbs
from spikingtac.robot import Watchdog, WatchdogThread
from spikingtac.touch import SkinConfig, fit_force, synthetic_series
from stand_ins.known import known
from stand_ins.live import frame_of
from stand_ins.programs import program
from stand_ins.tracks import circling_tracks

PROJECT = Path(__file__).resolve().parents[2]
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]
MARK = "# runs in the tests"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.S | re.M)
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)")


def blocks() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        for index, code in enumerate(BLOCK.findall(page.read_text(encoding="utf-8"))):
            yield f"{page.relative_to(PROJECT)}[{index}]", code


def calibration_of(source: st.SceneSource) -> st.Calibration:
    """Return what a calibration of the scene would find."""
    return known(source.reference_px, source.radius_px, step=0.14)


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the calibration, the recording and the tracks that the examples name."""
    folder, scene = tmp_path_factory.mktemp("named"), st.load_scene("finger-torsion")
    calibration_of(st.SceneSource(scene)).save(folder / "left_finger.json")
    st.simulate(scene, folder / "twist", seed=1, duration_s=1.0)
    for name in ("tracks.npz", "other.npz"):
        circling_tracks(estimates=20).save(folder / name)
    return folder


@pytest.fixture
def beside(named: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of each example's own with copies of these."""
    monkeypatch.chdir(shutil.copytree(named, tmp_path / "beside"))
    return Path.cwd()


@pytest.mark.parametrize("code", [pytest.param(c, id=n) for n, c in blocks() if c.startswith(MARK)])
def test_code_runs(code: str, beside: Path) -> None:
    exec(compile(code, "documentation", "exec"), {"__name__": "documentation"})


def test_links_lead_somewhere() -> None:
    found = [(page, to) for page in PAGES for to in LINK.findall(page.read_text(encoding="utf-8"))]
    local = [(page, to) for page, to in found if "://" not in to]
    assert [(page, to) for page, to in local if not (page.parent / to).exists()] == []


def test_the_paper_s_map_names_what_exists() -> None:
    page = PROJECT / "docs" / "explanation" / "paper-map.md"
    named = re.findall(r"`([\w/]+\.py)`", page.read_text(encoding="utf-8"))
    assert len(named) > 10
    roots = (PROJECT / "src" / "spikingtac", PROJECT / "tests", PROJECT)
    assert [name for name in named if not any((root / name).is_file() for root in roots)] == []


def test_the_readme_holds_the_two_commands() -> None:
    text = (PROJECT / "README.md").read_text(encoding="utf-8")
    first_screen = text.split("\n## ")[0]
    for command in (
        "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/spikingtac demo",
        "python3 -m venv .venv && .venv/bin/pip install -e '.[dev]' && .venv/bin/python -m pytest",
    ):
        assert command in first_screen
    assert "without relation to its authors" in first_screen


def test_the_reference_pages_are_those_of_the_code() -> None:
    script = PROJECT / "scripts" / "reference_pages.py"
    done = subprocess.run([sys.executable, script, "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_notebook_is_made_from_the_page() -> None:
    script = program("scripts/tutorial_notebook.py")
    page = PROJECT / "docs" / "tutorial" / "first-figure.md"
    written = page.with_suffix(".ipynb").read_text("utf-8")
    assert written == script.text_of(page.read_text("utf-8")), (
        "run: python scripts/tutorial_notebook.py"
    )
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    nbformat.validate(json.loads(written))


# What a block names -> what no test can give it; its names are looked up.
NEEDS = {
    "openmv:": "a camera",
    "st.approach(": "an arm that moves",
    "MineSource": "an installed package",
    "spikingtac_mujoco": "the package of an integration",
}


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A folder with the files, and the names, that the pages have made before."""
    folder = tmp_path_factory.mktemp("given")
    source = st.SceneSource(st.load_scene("finger-torsion"), duration_s=0.6)
    own = calibration_of(source)
    skin = synthetic_series(SkinConfig(), own.reference_px, 15.4, frames=70)
    fit_force(skin).save(folder / "force.onnx")
    (folder / "training").mkdir()
    weights = resources.files("spikingtac.denoise") / "weights" / "lean-int8.onnx"
    shutil.copy(str(weights), folder / "training")
    (folder / "day_tracks").mkdir()
    (folder / "day_tracks" / "results.csv").write_text("source,displacement_max_px\na.raw,2.5\n")
    windows = [(window,) for window in st.windows(source, period_us=1_000)]
    rest = own.reference_px
    frames = [frame_of(t_us, rest, 0.0 * rest) for t_us in range(0, 600_000, 1_000)]
    arm = SimpleNamespace(stop=lambda: None, confirm_stop=lambda: None)
    names = {"Watchdog": Watchdog, "time": time, "arm": arm}
    names |= {"WatchdogThread": WatchdogThread, "st": st, "calibration": own, "frame": frames[-1]}
    return folder, names | {"quiet_windows": windows[:300], "windows": windows, "frames": frames}


@pytest.mark.parametrize(
    "code",
    [pytest.param(c, id=n) for n, c in blocks() if "how-to/" in n and not c.startswith(MARK)],
)
def test_a_block_runs_with_what_its_page_gives(
    code: str, given: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, names = given
    monkeypatch.chdir(folder)
    compiled = compile(code, "documentation", "exec")
    if any(word in code for word in NEEDS):
        for name in {name for name in compiled.co_names if f"st.{name}" in code}:
            assert hasattr(st, name)
        return
    exec(compiled, {"__name__": "documentation", **names})


PICTURE = re.compile(r"!\[[^\]]*\]\(([^)\s]+)\)")
COMMAND = re.compile(r"`((?:spikingtac|python) [^`]+)`", re.S)
NEAR = 900  # Letters before and after a picture in which its command stands.
SCREENSHOTS = {"viewer.png"}  # Pictures of a browser, which no command of this package makes.


def test_every_picture_has_a_command_that_exists_with_its_options() -> None:
    commands: set[str] = set()
    for page in [*PAGES, PROJECT / "hardware" / "README.md"]:
        text = page.read_text(encoding="utf-8")
        for found in PICTURE.finditer(text):
            around = COMMAND.findall(text[max(found.start() - NEAR, 0) : found.end() + NEAR])
            assert around or Path(found.group(1)).name in SCREENSHOTS, f"{page}: {found.group(1)}"
            commands |= {" ".join(line.split()) for line in around}
    assert len(commands) >= 4
    for command in commands:
        program, first, *rest = shlex.split(command)
        if first == "-m":
            assert [*(PROJECT / "integrations").rglob(f"{rest[0]}/__main__.py")], command
        elif program == "python":
            assert (PROJECT / first).is_file(), command
        else:
            assert first in verbs(), command
            # A bare verb is a mention, no command.
            assert not rest or _parsed(function_of(first)[1], first, rest) is not None


MOST_WORDS = 30

# Former private words: hysteresis of pixels, leak, direction of motion, observation.
RETIRED = re.compile(
    r"\b(eas(?:ed|ing) outlines?|backlash|ground returns?|turn votes?|desk|sightings?|custody)\b",
    re.I,
)
NO_PROSE = re.compile(r"^```.*?^```|^ {4,}\S[^\n]*$|^#[^\n]*$", re.S | re.M)
NEW_ITEM = re.compile(r"\n(?=\s*(?:[-*]|\d+\.) )")
END = re.compile(r"(?<=[.!?;])\s+(?=[A-Z`*\[(\d])|(?<=:)\s+(?=[A-Z`])")


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a page in Markdown: of its paragraphs, list items and cells."""
    for block in re.split(r"\n\s*\n", NO_PROSE.sub("", text)):
        if block.lstrip().startswith("|"):
            # Cells hold lists, whose items semicolons separate.
            pieces = [item for row in block.splitlines() for item in re.split(r" \| |; ", row)]
        else:
            pieces = NEW_ITEM.split(block)
        for piece in pieces:
            plain = re.sub(r"`[^`]*`", "CODE", re.sub(r"\]\([^)]*\)", "]", piece))
            yield from END.split(" ".join(plain.split()))


def words(sentence: str) -> int:
    return len([word for word in sentence.split() if re.search(r"\w", word)])


@pytest.mark.parametrize(
    "page", [*PAGES, PROJECT / "CHANGELOG.md"], ids=lambda page: str(page.relative_to(PROJECT))
)
def test_sentences_are_short_and_words_are_the_fields(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert [line for line in sentences(text) if words(line) > MOST_WORDS] == []
    assert [hit.group() for hit in RETIRED.finditer(text)] == []
