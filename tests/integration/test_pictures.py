"""Pictures of the front page are what their commands make today, simulated and recorded ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from spikingtac.cli.main import main
from spikingtac.tracks import Tracks
from stand_ins.calibrated import calibrated

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"

# Pictures are compared in cells of this side, so that fonts and the smoothing of a line count
# little.
CELL_PX = 8
MOST_DIFFERENT_CELLS = 0.02  # Share of the cells that may differ.
CELL_LEVELS = 24.0  # Grey levels of 255 from which on a cell differs.


def different_cells(made: Path, frame: int = 0, later: int = 0) -> float:
    """Return the share of the cells in which a picture differs from the stored one.

    Args:
        made: The picture or animation; the stored one has its name.
        frame: Which picture of an animation.
        later: How many pictures later the stored animation shows it.
    """
    first, second = _cells(made, frame), _cells(IMAGES / made.name, frame + later)
    assert first.shape == second.shape
    return float((np.abs(first - second).max(axis=2) > CELL_LEVELS).mean())


def _cells(path: Path, frame: int) -> np.ndarray:
    with Image.open(path) as picture:
        picture.seek(frame)
        rgb = np.asarray(picture.convert("RGB"), float)
    rows, columns = (length // CELL_PX for length in rgb.shape[:2])
    whole = rgb[: rows * CELL_PX, : columns * CELL_PX]
    return whole.reshape(rows, CELL_PX, columns, CELL_PX, 3).mean(axis=(1, 3))


def frames_of(path: Path) -> int:
    with Image.open(path) as picture:
        return picture.n_frames


@pytest.mark.slow
def test_the_demo(tmp_path: Path) -> None:
    summary, animation = tmp_path / "demo.png", tmp_path / "demo.gif"
    for made, seconds in ((summary, "12"), (animation, "1.4")):  # a third of the animation's 4.2 s
        given = ["--seed", "1", "--seconds", seconds, "--export", str(made)]
        assert main(["view", "demo", *given]) == 0
    frames = frames_of(animation)
    assert 3 * frames == frames_of(IMAGES / "demo.gif")
    assert different_cells(summary) < MOST_DIFFERENT_CELLS
    for frame in (0, frames // 2, frames - 1):
        assert different_cells(animation, frame) < MOST_DIFFERENT_CELLS, frame


@pytest.fixture(scope="module")
def tracks(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    recording, calibration = data_dir / "gel" / "real_presses.aedat4", folder / "calibration.json"
    calibrated(recording).save(calibration)
    line = ["track", str(recording), "--calibration", str(calibration)]
    assert main([*line, "-o", str(folder / "tracks.npz")]) == 0
    return folder / "tracks.npz"


def test_the_four_recorded_presses_are_the_touches(
    data_dir: Path, tracks: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["touch", str(tracks), "--json", "-o", str(tracks.with_suffix(".csv"))]) == 0
    touches = json.loads(capsys.readouterr().out)["touches"]
    with np.load(data_dir / "gel" / "real_presses.reference.npz") as known:
        bursts_us = known["burst_us"] + int(Tracks.load(tracks).t_us[0])
    assert len(touches) == 4
    for touch, press_us, release_us in zip(touches, bursts_us[::2], bursts_us[1::2], strict=True):
        assert abs(touch["begin_us"] - press_us[0]) < 100_000
        assert release_us[0] - 100_000 < touch["end_us"] < release_us[1] + 100_000


def test_the_recorded_pictures(tracks: Path, tmp_path: Path) -> None:
    middle = ["--from-s", "39.2", "--to-s", "39.9", "--slow", "2"]  # of 38.5 to 40.6 s
    for name, options in (
        ("recorded_course.png", []),
        ("recorded_field.png", ["--kind", "field", "--at-s", "39.8"]),
        ("recorded_press.gif", middle),
    ):
        assert main(["plot", str(tracks), *options, "-o", str(tmp_path / name)]) == 0
    for name in ("recorded_course.png", "recorded_field.png"):
        assert different_cells(tmp_path / name) < MOST_DIFFERENT_CELLS, name
    press = tmp_path / "recorded_press.gif"
    frames, stored = frames_of(press), frames_of(IMAGES / press.name)
    assert stored == 3 * frames - 2, "the last picture of one is the next one's first"
    for frame in (0, frames // 2, frames - 1):
        # A field that is pressed differs from one at rest in 2 % of the cells.
        assert different_cells(press, frame, stored // 3) < MOST_DIFFERENT_CELLS / 4, frame
