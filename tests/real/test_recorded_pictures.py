"""The front page's pictures of the real recording are what its commands make today."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from spikingtac.cli.main import main
from stand_ins.calibrated import calibrated
from stand_ins.pictures import MOST_DIFFERENT_CELLS, different_cells

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"


@pytest.fixture(scope="module")
def tracks(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    recording, calibration = data_dir / "gel" / "real_presses.aedat4", folder / "calibration.json"
    calibrated(recording).save(calibration)
    line = ["track", str(recording), "--calibration", str(calibration)]
    assert main([*line, "-o", str(folder / "tracks.npz")]) == 0
    return folder / "tracks.npz"


@pytest.mark.parametrize(
    ("name", "options"),
    [("recorded_course", ()), ("recorded_field", ("--kind", "field", "--at-s", "39.8"))],
)
def test_a_picture(name: str, options: tuple[str, ...], tracks: Path, tmp_path: Path) -> None:
    made = tmp_path / f"{name}.png"
    assert main(["plot", str(tracks), *options, "-o", str(made)]) == 0
    assert different_cells(made, IMAGES / made.name) < MOST_DIFFERENT_CELLS


def test_the_animation(tracks: Path, tmp_path: Path) -> None:
    made, stored = tmp_path / "press.gif", IMAGES / "recorded_press.gif"
    span = ["--from-s", "38.5", "--to-s", "40.6", "--slow", "2"]
    assert main(["plot", str(tracks), *span, "-o", str(made)]) == 0
    with Image.open(made) as now, Image.open(stored) as then:
        assert now.n_frames == then.n_frames
        frames = now.n_frames
    for frame in (0, frames // 2, frames - 1):
        assert different_cells(made, stored, frame) < MOST_DIFFERENT_CELLS, frame
