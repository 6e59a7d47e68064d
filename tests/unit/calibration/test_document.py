from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError

MINIMAL = {
    "schema": 1,
    "size": [320, 320],
    "grid": [1, 2],
    "reference_px": [[10.0, 20.0], [30.0, 20.0]],
    "radius_px": [7.0, 7.5],
}


def test_a_minimal_file_by_hand_is_accepted() -> None:
    calibration = Calibration.from_document(MINIMAL)
    assert calibration.grid == (1, 2)
    assert calibration.polarity == "white"
    assert calibration.step_on is None
    np.testing.assert_array_equal(calibration.radius_px, [7.0, 7.5])


def test_one_radius_stands_for_all() -> None:
    calibration = Calibration.from_document({**MINIMAL, "radius_px": 7.0})
    np.testing.assert_array_equal(calibration.radius_px, [7.0, 7.0])


def test_save_and_load_agree(tmp_path: Path) -> None:
    document = {**MINIMAL, "step_on": 0.15, "polarity": "dark", "provenance": {"from": "slides"}}
    document["hot_px"] = [[5, 6], [319, 0]]
    calibration = Calibration.from_document(document)
    calibration.save(tmp_path / "c.json")
    again = Calibration.load(tmp_path / "c.json")
    np.testing.assert_array_equal(again.reference_px, calibration.reference_px)
    assert again.hot_px is not None
    assert again.hot_px.tolist() == [[5, 6], [319, 0]]
    assert (again.step_on, again.polarity, again.provenance) == (0.15, "dark", {"from": "slides"})


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"schema": 2}, "schema is 2"),
        ({"grid": [2, 2]}, "asks for 4 points"),
        ({"grid": [0, 2]}, "must be positive"),
        ({"radius_px": [7.0, -1.0]}, "radii positive"),
        ({"radius_px": [7.0]}, "expected \\(2,\\)"),
        ({"reference_px": [[1.0, float("nan")], [2.0, 3.0]]}, "finite"),
        ({"polarity": "blue"}, "'white' and 'dark'"),
        ({"step_on": -0.1}, "step_on is -0.1"),
        ({"hot_px": [[320, 0]]}, "hot_px holds a pixel off the sensor"),
        ({"hot_px": [5]}, "column and the row"),
        ({"hot_px": [[0.5, 1.0]]}, "column and the row"),
        ({"size": "large"}, "needs schema 1"),
    ],
)
def test_unfit_values_are_named(change: dict[str, object], named: str) -> None:
    with pytest.raises(CalibrationError, match=named):
        Calibration.from_document({**MINIMAL, **change})


@pytest.mark.parametrize("key", ["size", "grid", "reference_px", "radius_px"])
def test_missing_keys_are_named(key: str) -> None:
    document = {name: value for name, value in MINIMAL.items() if name != key}
    with pytest.raises(CalibrationError, match=f"'{key}' is missing"):
        Calibration.from_document(document)


def test_a_missing_file_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="spikingtac calibrate"):
        Calibration.load(tmp_path / "none.json")


def test_what_is_no_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text("grid = 8")
    with pytest.raises(CalibrationError, match="not JSON"):
        Calibration.load(tmp_path / "c.json")


def test_an_earlier_file_holds_steps_for_another_map() -> None:
    former = {**MINIMAL, "step_on": 0.4, "step_off": 0.2, "marker_step_on": [0.4, 0.5]}
    former |= {"band_scale_on": 0.41, "band_scale_off": 1.0}
    calibration = Calibration.from_document(former)
    assert (calibration.step_on, calibration.step_off) == pytest.approx((0.164, 0.2))
    np.testing.assert_allclose(calibration.marker_step_on, [0.164, 0.205])
