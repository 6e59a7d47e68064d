"""The file of a calibration: what is read, what survives, and what is refused by name."""

import base64
import json
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.document import pack_map
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError

SIZE = (70, 50)
MINIMAL: dict[str, Any] = {
    "schema": 1,
    "size": list(SIZE),
    "grid": [1, 2],
    "reference_px": [[10.0, 20.0], [30.0, 20.0]],
    "radius_px": [7.0, 7.5],
}
LENS = dict.fromkeys(("half_diagonal_px", "radial", "radial_sigma", "residual_mm"), 0.5)
LENS |= {"center_px": [35.0, 25.0], "homography": np.eye(3).tolist()}


def packed(raw: bytes) -> str:
    return base64.b64encode(zlib.compress(raw)).decode()


def test_a_minimal_file_by_hand_is_accepted() -> None:
    calibration = Calibration.from_document(MINIMAL)
    assert (calibration.grid, calibration.polarity) == ((1, 2), "white")
    assert calibration.step_on is None
    np.testing.assert_array_equal(calibration.radius_px, [7.0, 7.5])
    one_radius = Calibration.from_document({**MINIMAL, "radius_px": 7.0})
    np.testing.assert_array_equal(one_radius.radius_px, [7.0, 7.0])
    nulls = {"hysteresis": None, "provenance": None, "band_scale_on": None, "lens": None}
    assert Calibration.from_document(MINIMAL | nulls).provenance == {}
    free = Calibration.from_document({**MINIMAL, "grid": None})
    assert free.scale() == {"grid": None}
    assert free.with_pitch(2.0).px_per_mm == 10.0
    with pytest.raises(ValueError, match="pitch_mm"):
        free.with_pitch(0.0)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("radius_px", np.full(6, 7.0), r"possible: radius_px is .* of shape \(6,\), .* 2 markers"),
        (
            "reference_px",
            [[9, 9], [9.2, 9]],
            r"one and the same pixel, \[9.2, 9.0\]; leave out one$",
        ),
        ("polarity", "black", "polarity is 'black', valid are 'white' and 'dark'$"),
    ],
)
def test_what_no_file_may_hold_is_refused_by_hand_too(name: str, value: Any, told: str) -> None:
    given: dict[str, Any] = {one: MINIMAL[one] for one in MINIMAL if one != "schema"}
    assert Calibration(**given).reference_px.shape == (2, 2)
    with pytest.raises(CalibrationError, match=told):
        Calibration(**given | {name: value})


def test_what_is_saved_is_loaded_again(tmp_path: Path) -> None:
    steps = (np.random.default_rng(0).integers(0, 256, SIZE[::-1]) / 1000).astype(np.float32)
    steps[0, :2] = 0.13949, 0.0
    values = {
        "polarity": "dark", "step_on": 0.15, "recovery_s": 0.2, "hot_px": [[5, 6], [69, 0]],
        "marker_contrast": [4.0, 5.0], "marker_edge_px": [0.8, 0.9], "marker_step_on": [0.12, 0.1],
        "marker_step_off": [0.55, 0.5], "marker_measured": [False, True],
        "step_on_map": pack_map(steps), "provenance": {"from": "slides"},
    }  # fmt: skip
    Calibration.from_document(MINIMAL | values).save(tmp_path / "c.json")
    again = Calibration.load(tmp_path / "c.json")
    for name, value in values.items():
        kept = getattr(again, name)
        if name == "step_on_map":
            np.testing.assert_allclose(kept, steps, atol=6e-5)
        else:
            assert (kept.tolist() if isinstance(kept, np.ndarray) else kept) == value
    assert again.step_off_map is None


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"schema": 2}, "schema is 2"),
        ({"size": "large"}, "needs schema 1"),
        ({"size": [10**400, 320]}, "size is .* width and height"),
        ({"size": [1 << 20, 1 << 20]}, "1048576x1048576 px is not possible"),
        ({"grid": [2, 2]}, "x and y of each of 4 markers"),
        ({"grid": [0, 2]}, "grid is .* two whole numbers, .* 1 to"),
        ({"grid": [1.5, 2]}, "two whole numbers"),
        ({"radius_px": [7.0, -1.0]}, "radius_px is .* radii of 2 markers, px, 0.001 to"),
        ({"radius_px": [7.0]}, "the radii of 2 markers"),
        ({"radius_px": [10**400, 8]}, "needs schema 1"),
        ({"radius_px": 80.0}, "larger than the sensor"),
        ({"reference_px": [[1.0, float("nan")], [2.0, 3.0]]}, "nan.* must hold x and y"),
        ({"reference_px": [[10.0, 10.0], [10.0, 10.0]]}, "one and the same pixel"),
        ({"reference_px": [[10.0, 10.0], [9_000.0, 10.0]]}, "marker 1 .* lies off the sensor"),
        ({"polarity": "blue"}, "'white' and 'dark'"),
        ({"hot_px": [[70, 0]]}, "hot_px holds a pixel off the sensor"),
        ({"hot_px": [5]}, "column and the row"),
        ({"hot_px": [[0.5, 1.0]]}, "column and the row"),
        ({"provenance": ["a"]}, r"provenance is \['a'\], it must be an object"),
        ({"provenance": 0}, "provenance is 0, it must be an object"),
        ({"hysteresis": 3}, "hysteresis is 3, it must be a name"),
        ({"step_onn": 0.15}, "unknown key 'step_onn'; did you mean 'step_on'.*valid: schema"),
        ({"band_scale_off": 0.4}, "version 0.1; calibrate the sensor again"),
        ({"band_scale_on": 0.4}, "version 0.1; calibrate the sensor again"),
        ({"step_on": -0.1}, "step_on is -0.1"),
        ({"lag_us": True}, "lag_us is True, it must hold a delay"),
        ({"step_on": 1e300}, "step_on is 1e[+]300, .* 0.0001 to 1"),
        ({"radius_px": ["7", "7"]}, "must hold the radii"),
        ({"lens": LENS | {"residual_mm": 1e300}}, "lens: residual_mm is 1e[+]300, .* 0 to 1e[+]06"),
        ({"lag_us": 1e18}, "lag_us is .* a delay, us, 0 to 100000"),
        ({"marker_contrast": [4.0]}, "for each of 2 markers"),
        ({"marker_edge_px": [-1.0, 1.0]}, "px, for each of 2 markers, 0.001 to 100"),
        ({"marker_step_on": ["much", 1]}, "much"),
        ({"marker_measured": [1, 0]}, "true or false"),
        ({"step_on_map": "no base64!"}, "step_on_map is no deflated map"),
        ({"step_on_map": [0.1, 0.2]}, "step_on_map is no deflated map"),
        ({"step_on_map": packed(bytes(34))}, "step_on_map holds another number of bytes"),
        ({"step_on_map": packed(bytes(10**6))}, "step_on_map holds another number of bytes"),
        (
            {"step_on_map": base64.b64encode(zlib.compress(bytes(7_000))[:-2]).decode()},
            "step_on_map holds another number of bytes",
        ),
    ],
)
def test_unfit_values_are_named(change: dict[str, object], named: str) -> None:
    with pytest.raises(CalibrationError, match=named):
        Calibration.from_document(MINIMAL | change)


@pytest.mark.parametrize("key", ["size", "grid", "reference_px", "radius_px"])
def test_missing_keys_are_named(key: str) -> None:
    document = {name: value for name, value in MINIMAL.items() if name != key}
    with pytest.raises(CalibrationError, match=f"'{key}' is missing"):
        Calibration.from_document(document)


def test_what_is_no_calibration_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="spikingtac calibrate"):
        Calibration.load(tmp_path / "none.json")
    (tmp_path / "c.json").write_text("grid = 8")
    with pytest.raises(CalibrationError, match="not JSON"):
        Calibration.load(tmp_path / "c.json")
    (tmp_path / "c.json").write_text(json.dumps([1]))
    with pytest.raises(CalibrationError, match="not a JSON object"):
        Calibration.load(tmp_path / "c.json")


def test_what_could_not_be_loaded_is_not_written(tmp_path: Path) -> None:
    known = Calibration.from_document(MINIMAL)
    with pytest.raises(CalibrationError, match="off the sensor"):
        replace(known, reference_px=known.reference_px + 1e4).save(tmp_path / "c.json")
    assert not (tmp_path / "c.json").exists()


@pytest.mark.parametrize("contrast", [5.0, 0.2])
def test_a_profile_is_the_normalised_logarithm_of_a_blurred_disc(contrast: float) -> None:
    profile = DiscProfile(contrast, edge_px=0.7)
    q, h = np.linspace(-4.0, 4.0, 33), 1e-6
    intensity = 1.0 + (contrast - 1.0) / (1.0 + np.exp(q / 0.7))
    np.testing.assert_allclose(profile.level(q), np.log(intensity) / np.log(contrast), atol=1e-12)
    numeric = (profile.level(q + h) - profile.level(q - h)) / (2 * h)
    np.testing.assert_allclose(profile.slope(q), numeric, atol=1e-6)
