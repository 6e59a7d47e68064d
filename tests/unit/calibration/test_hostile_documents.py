"""Calibrations with numbers that no sensor has are refused by name."""

from __future__ import annotations

import json
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
        {"band_scale_on": 1.0},
        {"band_scale_on": 0.0, "band_scale_off": 1.0},
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


def test_a_plain_document_is_read(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps(document()))
    assert len(Calibration.load(tmp_path / "c.json").radius_px) == 2
