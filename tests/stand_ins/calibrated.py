"""Calibrations of recordings beside the project, each computed once in a process."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.open import open_events
from spikingtac.markers.calibration.calibrate import calibrate


@cache
def calibrated(path: Path) -> Calibration:
    """Return what a recording teaches, without its lag; skips the test where there is none."""
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the test recordings")
    return calibrate(open_events(path), estimate_lag=None)
