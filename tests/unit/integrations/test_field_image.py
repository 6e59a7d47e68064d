"""The image of the LeRobot plug-in."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from stand_ins.programs import program

FOLDER = "integrations/lerobot_camera_spikingtac/lerobot_camera_spikingtac"
field_image = program(f"{FOLDER}/field_image.py")


def test_a_cell_holds_its_markers_displacement_and_whether_it_was_predicted() -> None:
    rng = np.random.default_rng(1)
    moved = rng.uniform(-16.0, 16.0, (12, 2))
    coasted = rng.random(12) < 0.3
    image = field_image.field_image(moved, coasted, (3, 4), 16.0, 5)
    assert (image.shape, image.dtype) == ((15, 20, 3), np.uint8)
    cells = image[2::5, 2::5].reshape(12, 3).astype(float)
    assert np.abs((cells[:, :2] - 128.0) / 127.0 * 16.0 - moved).max() <= 16.0 / 254 + 1e-6
    np.testing.assert_array_equal(cells[:, 2] > 128, coasted)
    far = field_image.field_image(np.array([[0.0, -99.0]]), coasted[:1], (1, 1), 16.0, 1)
    assert far[0, 0, :2].tolist() == [128, 1]


def test_markers_without_rows_are_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = type("CameraConfig", (), {"register_subclass": lambda name: lambda kind: kind})
    base.width = base.height = base.fps = None
    monkeypatch.setitem(sys.modules, "lerobot.cameras.configs", SimpleNamespace(CameraConfig=base))
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({"grid": None, "reference_px": [[0, 0]] * 5}))
    kind = program(f"{FOLDER}/config_camera.py").SpikingTacCameraConfig
    made = kind(source="twin:demo", calibration=str(path))
    assert (made.width, made.height, made.fps) == (40, 8, 30)
