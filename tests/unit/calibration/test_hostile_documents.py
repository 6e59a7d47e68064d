"""Calibrations with numbers that no sensor has are refused by name."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError


def document(**changes: Any) -> dict[str, Any]:
    plain = {
        "schema": 1,
        "size": [320, 320],
        "grid": [1, 2],
        "reference_px": [[100.0, 100.0], [200.0, 100.0]],
        "radius_px": [8.0, 8.0],
    }
    return plain | changes


@pytest.mark.parametrize(
    "changes",
    [
        {"size": [float("inf"), 320]},
        {"size": [10**400, 320]},
        {"size": [1 << 20, 1 << 20]},
        {"grid": [float("nan"), 2]},
        {"reference_px": [[10**400, 1], [2, 3]]},
        {"radius_px": [10**400, 8]},
        {"radius_px": 1e300},
        {"px_per_mm": 10**400},
        {"band_scale_on": 0.0},
        {"step_on": float("inf")},
        {"provenance": 5},
        {"provenance": ["a"]},
        {"reference_px": [[100.0, 100.0], [100.0, 100.0]]},
        {"reference_px": [[100.0, 100.0], [9_000.0, 100.0]]},
        {"reference_px": [[100.0, 100.0], [-60.0, 100.0]]},
    ],
)
def test_unfit_numbers_are_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    (tmp_path / "c.json").write_text(json.dumps(document(**changes)))
    with pytest.raises(CalibrationError, match=r"a calibration needs|is not JSON"):
        Calibration.load(tmp_path / "c.json")


@pytest.mark.parametrize(
    ("name", "value"),
    [("lag_us", 1e18), ("step_on", 1e300), ("contrast", 0.5), ("px_per_mm", 0.0), ("edge_px", 1e9)],
)
def test_implausible_numbers_are_refused_with_their_range(name: str, value: float) -> None:
    with pytest.raises(CalibrationError, match=f"{name} is .* must lie in"):
        Calibration.from_document(document(**{name: value}))


def test_grids_are_whole_numbers_or_none() -> None:
    with pytest.raises(CalibrationError, match="two whole numbers"):
        Calibration.from_document(document(grid=[1.5, 2]))
    free = Calibration.from_document(document(grid=None))
    assert free.scale() == {"grid": None}
    assert free.with_pitch(2.0).px_per_mm == 50.0
    with pytest.raises(ValueError, match="pitch_mm"):
        free.with_pitch(0.0)


def test_what_could_not_be_loaded_is_not_written(tmp_path: Path) -> None:
    free = Calibration.from_document(document(grid=None))
    with pytest.raises(CalibrationError, match="off the sensor"):
        replace(free, reference_px=free.reference_px + 1e4).save(tmp_path / "c.json")
    assert not (tmp_path / "c.json").exists()
