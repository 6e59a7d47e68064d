"""The real recording: where its markers stand, and that the front page's pictures show it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from spikingtac.cli.main import main
from spikingtac.tracks import Tracks
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


def test_the_four_presses_are_the_touches(
    data_dir: Path, tracks: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["touch", str(tracks), "--json", "-o", str(tracks.with_suffix(".csv"))]) == 0
    touches = json.loads(capsys.readouterr().out)["touches"]
    with np.load(data_dir / "gel" / "real_presses.reference.npz") as known:
        bursts_us = known["burst_us"] + int(Tracks.load(tracks).t_us[0])
    assert len(touches) == 4, "(recorded)"
    for touch, press_us, release_us in zip(touches, bursts_us[::2], bursts_us[1::2], strict=True):
        assert abs(touch["begin_us"] - press_us[0]) < 100_000
        assert release_us[0] - 100_000 < touch["end_us"] < release_us[1] + 100_000


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
    middle = ["--from-s", "39.2", "--to-s", "39.9", "--slow", "2"]  # of 38.5 to 40.6 s
    assert main(["plot", str(tracks), *middle, "-o", str(made)]) == 0
    with Image.open(made) as now, Image.open(stored) as then:
        frames, later = now.n_frames, then.n_frames // 3
        assert then.n_frames == 3 * frames - 2, "the last picture of one is the next one's first"
    for frame in (0, frames // 2, frames - 1):
        # A field that is pressed differs from one at rest in 2 % of the cells.
        assert different_cells(made, stored, frame, later) < MOST_DIFFERENT_CELLS / 4, frame
