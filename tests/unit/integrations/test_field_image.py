"""The image of the LeRobot plug-in."""

import importlib.util
from pathlib import Path

import numpy as np

FOLDER = (
    Path(__file__).resolve().parents[3] / "integrations" / "lerobot_camera_spikingtac"
) / "lerobot_camera_spikingtac"
SPEC = importlib.util.spec_from_file_location("field_image", FOLDER / "field_image.py")
assert SPEC is not None
assert SPEC.loader is not None
field_image = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(field_image)


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
