"""One calibration per sensor and camera, learnt from bootstrap slides and stored in the run."""

from __future__ import annotations

import hashlib
from dataclasses import fields
from pathlib import Path

import numpy as np

from spikingtac.atomic_files import replacing
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import digest, load_config
from spikingtac.events.open import open_events
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.schema import to_mapping
from spikingtac_paper.harness.fingerprint import code_digest
from spikingtac_paper.trials.trials import V2E, Trial


def calibration_digest(calibration: Calibration, names: tuple[str, ...] = ()) -> str:
    """Return the digest of the calibration fields that a method reads.

    Args:
        calibration: Calibration of the sensor.
        names: Names of the fields; empty means all but the provenance.
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

    The slides are recorded with the same camera preset and the same sensor, but without damaged
    markers and extra loss. All methods use the same calibration.

    Args:
        trial: Any trial of the sensor.
        folder: Folder of the run, which holds the calibrations.
        data: Folder of recordings from elsewhere.
    """
    slides = trial.bootstrap()
    settings = load_config("default").calibration
    key = digest(
        {
            "slides": slides.key(),
            "settings": to_mapping(settings),
            "code": code_digest(),
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
    with replacing(path) as temporary:
        calibration.save(temporary)
    # Read it back: a run that continues sees the same rounded numbers as one that began.
    return Calibration.load(path)
