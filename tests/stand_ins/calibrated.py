"""Calibrations of recordings beside the project, each computed once in a run of tests."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.open import open_events
from spikingtac.markers.calibration.calibrate import calibrate
from stand_ins.made_once import made_once


@cache
def calibrated(path: Path) -> Calibration:
    """Return what a recording teaches, without its lag; skips the test where there is none."""
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the test recordings")
    name = f"calibrated_{path.parent.name}_{path.name}"
    return made_once(name, lambda: calibrate(open_events(path), estimate_lag=None))
