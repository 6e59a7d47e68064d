import base64
import zlib
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.document import pack_map
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError

SIZE = (7, 5)
DOCUMENT = {
    "schema": 1,
    "size": list(SIZE),
    "grid": [1, 1],
    "reference_px": [[3.0, 2.0]],
    "radius_px": [2.0],
}


def packed(raw: bytes) -> str:
    return base64.b64encode(zlib.compress(raw)).decode()


def test_step_maps_survive_a_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    steps = (rng.integers(0, 256, (5, 7)) / 1000).astype(np.float32)
    text = pack_map(steps)
    calibration = Calibration.from_document({**DOCUMENT, "step_on_map": text})
    calibration.save(tmp_path / "c.json")
    again = Calibration.load(tmp_path / "c.json")
    assert again.step_off_map is None
    assert again.step_on_map is not None
    assert again.step_on_map.dtype == np.float32
    np.testing.assert_allclose(again.step_on_map, steps, atol=1e-6)


def test_steps_are_rounded_and_bounded() -> None:
    steps = np.zeros((5, 7), np.float32)
    steps[0, :3] = 0.13949, 0.9, 0.0
    read = Calibration.from_document({**DOCUMENT, "step_off_map": pack_map(steps)}).step_off_map
    assert read is not None
    np.testing.assert_allclose(read[0, :3], [0.1395, 0.9, 0.0], atol=1e-6)


def test_maps_of_version_0_1_are_read() -> None:
    steps = np.arange(35, dtype=np.uint8)
    read = Calibration.from_document({**DOCUMENT, "step_on_map": packed(steps.tobytes())})
    assert read.step_on_map is not None
    np.testing.assert_allclose(read.step_on_map.ravel(), steps / 1000.0, atol=1e-6)


def test_values_of_each_marker_survive_a_file(tmp_path: Path) -> None:
    values = {
        "marker_contrast": [4.0],
        "marker_edge_px": [0.8],
        "marker_step_on": [0.12],
        "marker_step_off": [0.55],
        "marker_measured": [False],
    }
    Calibration.from_document({**DOCUMENT, **values}).save(tmp_path / "c.json")
    again = Calibration.load(tmp_path / "c.json")
    for name, value in values.items():
        assert getattr(again, name).tolist() == value
    assert Calibration.from_document(DOCUMENT).marker_measured is None


@pytest.mark.parametrize(
    ("name", "value", "named"),
    [
        ("marker_contrast", [4.0, 4.0], "shape"),
        ("marker_edge_px", [-1.0], "positive"),
        ("marker_step_on", ["much"], "marker_step_on|much"),
        ("marker_measured", [1], "true or false"),
    ],
)
def test_unfit_values_of_markers_are_named(name: str, value: list[object], named: str) -> None:
    with pytest.raises(CalibrationError, match=named):
        Calibration.from_document({**DOCUMENT, name: value})


@pytest.mark.parametrize(
    ("value", "named"),
    [
        ("no base64!", "step_on_map is no base64"),
        ("AAAA", "does not inflate"),
        (
            packed(bytes(34)),
            "holds 34 bytes where the size 7x5 asks for two",
        ),
        (packed(bytes(10**6)), "holds more than 70 bytes where"),
        (base64.b64encode(zlib.compress(bytes(35))[:-2]).decode(), "step_on_map"),
        ([0.1, 0.2], "must be base64 text, got list"),
    ],
)
def test_unfit_maps_are_named(value: object, named: str) -> None:
    with pytest.raises(CalibrationError, match=named):
        Calibration.from_document({**DOCUMENT, "step_on_map": value})
