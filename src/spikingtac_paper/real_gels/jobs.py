"""The jobs of the experiment: the calibration of a sensor, or one method on one case."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import replacing, write_json
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import digest, load_config
from spikingtac.errors import SpikingTacError
from spikingtac.events.open import open_events
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.pipeline.follow import follow
from spikingtac_paper.harness.fingerprint import code_digest
from spikingtac_paper.harness.records import Record, load_record
from spikingtac_paper.real_gels.cases import GelCase
from spikingtac_paper.real_gels.scoring import Plateaus, plateau_scores, truth_scores
from spikingtac_paper.trials.calibrations import calibration_digest
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.methods import Method, main_methods
from spikingtac_paper.trials.prediction import Prediction

KEPT_HZ = 250.0
"""Rate at which estimates are stored and scored, Hz; a real recording lasts for minutes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GelJob:
    """One case, and one method on it.

    Attributes:
        case: The recording.
        data: Folder of the recording.
        folder: Folder of the run.
        method: Name of the method; empty makes the calibration only.
    """

    case: GelCase
    data: Path
    folder: Path
    method: str = ""


def calibration_path(job: GelJob) -> Path:
    """Return the file of a case's calibration, named by its recording and the code behind it."""
    code = code_digest()
    return job.folder / "calibrations" / f"{Path(job.case.calibrated_from).stem}-{code}.json"


def make_calibration(job: GelJob) -> str:
    """Calibrate the sensor of a case as ``spikingtac calibrate`` does without any option.

    Returns:
        The reason why that failed, or an empty text.
    """
    path = calibration_path(job)
    if path.is_file():
        return ""
    try:
        source = open_events(job.data / job.case.calibrated_from)
        calibration = calibrate(source, load_config("default").calibration)
    except SpikingTacError as error:
        return str(error)
    with replacing(path) as temporary:
        calibration.save(temporary)
    return ""


def run_method(job: GelJob) -> Record:
    """Track a recording with one method and score it, or read the results from disk."""
    calibration = Calibration.load(calibration_path(job))
    method = main_methods()[job.method]
    key = digest(
        {
            "calibration": calibration_digest(calibration, method.reads),
            "method": method.key(),
            "case": asdict(job.case),
            "kept_hz": KEPT_HZ,
        }
    )
    file = prediction_path(job)
    prediction = Prediction.load(file, key)
    if prediction is None:
        prediction = _tracked(job, method, calibration)
        prediction.save(file, key)
    path = job.folder / "scores" / job.method / f"{file.stem}.json"
    score_key = digest({"prediction": key, "code": code_digest()})
    record = load_record(path, score_key)
    if record is None:
        record = {"key": score_key, "method": job.method, "trial": _about(job.case),
                  "scores": _scores(job, prediction, calibration)}  # fmt: skip
        write_json(path, record)
    return record


def prediction_path(job: GelJob) -> Path:
    """Return the file of the estimates of a method on a case."""
    return job.folder / "predictions" / job.method / f"{job.case.name.replace('/', '-')}.npz"


def _tracked(job: GelJob, method: Method, calibration: Calibration) -> Prediction:
    frames = follow(
        open_events(job.data / job.case.events), method.build(calibration), method.rate_hz
    )
    return Prediction.collect(
        frames, calibration.reference_px, max(1, round(method.rate_hz / KEPT_HZ))
    )


def _scores(job: GelJob, prediction: Prediction, calibration: Calibration) -> dict[str, float]:
    if job.case.truth:
        truth = GroundTruth.load(job.data / job.case.truth)
        return truth_scores(prediction, truth, calibration)
    assert job.case.reference
    plateaus = Plateaus.load(job.data / job.case.reference)
    return plateau_scores(prediction, plateaus, calibration)


def _about(case: GelCase) -> dict[str, Any]:
    return {"case": case.name, "groups": [], "seed": 0, "source": case.source}
