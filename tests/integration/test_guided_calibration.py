"""``spikingtac calibrate`` of a camera: what still has to move is said while it goes on."""

import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli.main import main
from spikingtac.events.create import create_events
from stand_ins.piped_camera import PipedCamera
from stand_ins.sliding import GRID, MARKERS, SIZE, resting_px, sliding_packets


@pytest.fixture(scope="module")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("slides") / "slides.raw"
    with create_events(path, SIZE) as writer:
        for packet in sliding_packets():
            writer.write(packet)
    return path


def test_a_camera_says_what_has_to_move_and_ends_when_it_has(
    slides: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    PipedCamera(tmp_path / "live", slides.read_bytes(), pieces=400)
    target = tmp_path / "calibration.json"
    words = "calibrate", str(tmp_path / "live"), "-o", str(target), "--until-ready", "--json"
    assert main(words) == 0
    said = capsys.readouterr()
    assert f"{MARKERS} of {MARKERS} markers moved enough" in said.err.splitlines()[-1]
    assert json.loads(said.out)["grid"] == list(GRID)
    found = Calibration.load(target)
    assert np.hypot(*(found.reference_px - resting_px()).T).max() < 0.5
    assert found.provenance["unloaded_rests_us"][-1][1] < sliding_packets()[-1].t_end_us
