"""README and tutorial, run block by block in an empty folder; the tutorial as its notebook."""

import contextlib
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from spikingtac import sim
from spikingtac.schema import build, to_mapping
from spikingtac.sim import catalog
from spikingtac.sim.scene import Scene
from spikingtac.tracks import Tracks
from stand_ins.pasted import paste
from stand_ins.small_twin import SENSOR, slides_scene

PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module", autouse=True)
def without_a_screen() -> None:
    import matplotlib as mpl

    mpl.use("Agg")


@pytest.fixture(scope="module", autouse=True)
def small_scenes() -> Iterator[None]:
    """The scenes that the pages name, on a sensor of sixteen markers, and forces by regression.

    The whole sensor takes four times as long, and a network's training minutes more.
    """
    twist = to_mapping(catalog.load_scene("finger-torsion"))
    for part, settings in SENSOR.items():
        twist[part] |= settings
    scenes = {"bootstrap": slides_scene(), "finger-torsion": build(Scene, twist, "small twin")}
    with pytest.MonkeyPatch.context() as patch:
        for place in (catalog, sim):
            patch.setattr(place, "load_scene", lambda name: scenes[name])
        yield


@pytest.fixture(scope="module")
def readme_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder, empty before, into which the README was pasted."""
    folder = tmp_path_factory.mktemp("readme")
    with contextlib.chdir(folder):
        assert paste(PROJECT / "README.md", "## From the command line") >= 8
    return folder


@pytest.mark.slow
def test_the_readme_can_be_pasted(readme_folder: Path) -> None:
    found = {path.name for path in readme_folder.iterdir()}
    made = "bootstrap", "left_finger.json", "twist", "tracks.npz", "field.pdf", "twist.mp4"
    assert {*made} <= found
    # 15.5 px/mm in the middle; the lens leaves 15.0 px/mm on the average over 64 markers.
    assert Tracks.load(readme_folder / "tracks.npz").px_per_mm == pytest.approx(15.4, abs=0.1)


@pytest.mark.slow
def test_the_tutorial_s_notebook_runs(
    readme_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Both pages begin with the same simulation and calibration: these were run for the README.
    shutil.copytree(readme_folder / "bootstrap", tmp_path / "slides")
    shutil.copy(readme_folder / "left_finger.json", tmp_path / "finger.json")
    monkeypatch.chdir(tmp_path)
    notebook = PROJECT / "docs" / "tutorial" / "first-figure.ipynb"
    assert paste(notebook, ready=("slides", "finger.json")) >= 10
    for name in ("course.pdf", "field.pdf", "field.png", "torsion.pdf", "errors.pdf"):
        assert (tmp_path / name).stat().st_size > 2_000, name


@pytest.mark.parametrize("page", ["README.md", "docs/tutorial/first-figure.md"])
def test_both_pages_begin_with_the_same_commands(page: str) -> None:
    text = (PROJECT / page).read_text(encoding="utf-8")
    simulated = re.search(r"^spikingtac simulate bootstrap -o (\w+)", text, re.M)
    assert simulated
    calibrated = rf"^spikingtac calibrate {simulated.group(1)} -o \S+ --pitch-mm 2.4\b"
    assert re.search(calibrated, text, re.M)
