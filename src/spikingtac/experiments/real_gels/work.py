"""One piece of the experiment for one process: a calibration, or one method on one case."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import digest, load_config
from spikingtac.errors import SpikingTacError
from spikingtac.events.open import open_events
from spikingtac.experiments.harness.fingerprint import code_digest, modules_behind
from spikingtac.experiments.harness.run_folder import write_json
from spikingtac.experiments.real_gels.cases import GelCase
from spikingtac.experiments.real_gels.scoring import Plateaus, plateau_scores, truth_scores
from spikingtac.experiments.trials.calibrations import calibration_digest
from spikingtac.experiments.trials.ground_truth import GroundTruth
from spikingtac.experiments.trials.methods import Method, main_methods
from spikingtac.experiments.trials.prediction import Prediction
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.pipeline.follow import follow

KEPT_HZ = 250.0
"""Rate at which estimates are kept and scored; a real recording lasts for minutes."""

CALIBRATION_CODE = ("markers/calibration/calibrate.py",)
SCORING_CODE = ("experiments/real_gels/scoring.py",)


@dataclass(frozen=True, kw_only=True, slots=True)
class GelWork:
    """One case, and one method on it.

    Attributes:
        case: The recording.
        data: Folder that holds it.
        folder: The run's folder.
        method: Name of the method; empty makes the calibration only.
    """

    case: GelCase
    data: Path
    folder: Path
    method: str = ""


def calibration_path(work: GelWork) -> Path:
    """Return where the calibration of a case is kept, by its file and the code that makes it."""
    code = code_digest(modules_behind(CALIBRATION_CODE))
    return work.folder / "calibrations" / f"{Path(work.case.calibrated_from).stem}-{code}.json"


def make_calibration(work: GelWork) -> str:
    """Calibrate the sensor of a case as ``spikingtac calibrate`` does without any option.

    Returns:
        The reason why that failed, or an empty text.
    """
    path = calibration_path(work)
    if path.is_file():
        return ""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        source = open_events(work.data / work.case.calibrated_from)
        calibration = calibrate(source, load_config("default").calibration)
    except SpikingTacError as error:
        return str(error)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    calibration.save(partial)
    partial.replace(path)
    return ""


def run_method(work: GelWork) -> dict[str, Any]:
    """Track a recording with one method and score it; what is on disk already is read."""
    calibration = Calibration.load(calibration_path(work))
    method = main_methods()[work.method]
    key = digest(
        {
            "calibration": calibration_digest(calibration, method.reads),
            "method": method.key(),
            "case": asdict(work.case),
            "kept_hz": KEPT_HZ,
        }
    )
    file = prediction_path(work)
    prediction = Prediction.load(file, key)
    if prediction is None:
        prediction = _tracked(work, method, calibration)
        prediction.save(file, key)
    path = work.folder / "scores" / work.method / f"{file.stem}.json"
    score_key = digest({"prediction": key, "code": code_digest(modules_behind(SCORING_CODE))})
    record = _stored(path, score_key)
    if record is None:
        record = {"key": score_key, "method": work.method, "trial": _about(work.case),
                  "scores": _scores(work, prediction, calibration)}  # fmt: skip
        write_json(path, record)
    return record


def prediction_path(work: GelWork) -> Path:
    """Return where the estimates of a method on a case are kept."""
    return work.folder / "predictions" / work.method / f"{work.case.name.replace('/', '-')}.npz"


def _tracked(work: GelWork, method: Method, calibration: Calibration) -> Prediction:
    frames = follow(
        open_events(work.data / work.case.events), method.build(calibration), method.rate_hz
    )
    return Prediction.collect(
        frames, calibration.reference_px, max(1, round(method.rate_hz / KEPT_HZ))
    )


def _scores(work: GelWork, prediction: Prediction, calibration: Calibration) -> dict[str, float]:
    if work.case.truth:
        truth = GroundTruth.load(work.data / work.case.truth)
        return truth_scores(prediction, truth, calibration)
    assert work.case.reference
    plateaus = Plateaus.load(work.data / work.case.reference)
    return plateau_scores(prediction, plateaus, calibration)


def _about(case: GelCase) -> dict[str, Any]:
    return {"case": case.name, "groups": [], "seed": 0, "source": case.source}


def _stored(path: Path, key: str) -> dict[str, Any] | None:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if record.get("key") == key else None
