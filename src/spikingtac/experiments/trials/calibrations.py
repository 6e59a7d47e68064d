"""One calibration per sensor and camera, learnt from bootstrap slides, kept beside the results."""

from __future__ import annotations

import hashlib
import os
from dataclasses import fields
from pathlib import Path

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import digest, load_config
from spikingtac.events.open import open_events
from spikingtac.experiments.harness.fingerprint import code_digest, modules_behind
from spikingtac.experiments.trials.trials import V2E, Trial
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.schema import to_mapping

CODE = ("markers/calibration/calibrate.py",)
"""Where a calibration comes from."""


def calibration_digest(calibration: Calibration, names: tuple[str, ...] = ()) -> str:
    """Return the digest of what a method reads of a calibration.

    Args:
        calibration: Of the sensor.
        names: Fields; empty is all but the provenance.
    """
    known = tuple(one.name for one in fields(calibration) if one.name != "provenance")
    values = {name: getattr(calibration, name) for name in names or known}
    return digest({name: _plain(value) for name, value in values.items()})


def _plain(value: object) -> str:
    if isinstance(value, np.ndarray):
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    return repr(value)


def calibration_of(trial: Trial, folder: Path, data: Path | None = None) -> Calibration:
    """Return the calibration of a trial's sensor, as a user would have made it.

    The slides are filmed by the same camera preset on the same sensor, whole and without extra
    loss: markers break and events get lost later. All methods are given the same calibration.

    Args:
        trial: Any trial of the sensor.
        folder: The run's folder, where calibrations are kept.
        data: Folder of foreign recordings.
    """
    slides = trial.bootstrap()
    settings = load_config("default").calibration
    key = digest(
        {
            "slides": slides.key(),
            "settings": to_mapping(settings),
            "code": code_digest(modules_behind(CODE)),
        }
    )
    path = folder / "calibrations" / f"{trial.camera}-{trial.serial}-{key}.json"
    if path.is_file():
        return Calibration.load(path)
    if trial.camera == V2E:
        assert data is not None
        source = open_events(data / V2E / "bootstrap.raw")
    else:
        source = open_events(slides.record(folder))
    calibration = calibrate(source, settings)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    calibration.save(partial)
    partial.replace(path)
    # Read back, so that a run that goes on sees the same rounded numbers as one that began.
    return Calibration.load(path)
