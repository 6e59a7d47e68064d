"""``spikingtac calibrate`` of a camera: what still has to move is said while it goes on."""

from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from stand_ins.piped_camera import PipedCamera
from stand_ins.random_packets import save_events
from stand_ins.sliding import GRID, MARKERS, resting_px, sliding_packets
from stand_ins.verbs import Verbs


@pytest.fixture(scope="module")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_events(tmp_path_factory.mktemp("slides") / "slides.raw", *sliding_packets())


def test_a_camera_says_what_has_to_move_and_ends_when_it_has(
    slides: Path, tmp_path: Path, verbs: Verbs
) -> None:
    PipedCamera(tmp_path / "live", slides.read_bytes(), pieces=400)
    target = tmp_path / "calibration.json"
    told = verbs.told("calibrate", tmp_path / "live", "-o", target, "--until-ready")
    assert f"{MARKERS} of {MARKERS} markers moved enough" in verbs.err.splitlines()[-1]
    assert told["grid"] == list(GRID)
    found = Calibration.load(target)
    assert np.hypot(*(found.reference_px - resting_px()).T).max() < 0.5
    assert found.provenance["unloaded_rests_us"][-1][1] < sliding_packets()[-1].t_end_us
