"""Run methods on trials: predictions on disk, then scores.

A prediction is stored under the digest of the recording, of the calibration fields that the method
reads, of its name and configuration, and of the source code behind it. Unchanged results are not
computed again, and outdated ones are never used. One method on one trial is one job.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from spikingtac import Calibration
from spikingtac.config import digest
from spikingtac.types import EventPacket
from spikingtac_paper.harness.run import Progress, Record, RunOptions, code_digest, kept
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.methods import TRUTH, Method, apply_law
from spikingtac_paper.trials.metrics import point_scores
from spikingtac_paper.trials.prediction import Prediction
from spikingtac_paper.trials.trial import V2E, Trial, calibration_digest, calibration_of

# Rate at which predictions are stored and scored, Hz. Faster trackers still run at their rate.
KEPT_HZ = 500.0


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialJob:
    """One trial and the methods that run on it.

    Attributes:
        trial: The trial.
        methods: Names of the methods.
        table: Importable function that returns the methods by name.
        folder: Folder of the run.
        data: Folder of recordings from elsewhere, or None.
        calibrate: Whether the input to make is the calibration, or the recording.
    """

    trial: Trial
    methods: tuple[str, ...]
    table: Callable[[], Mapping[str, Method]]
    folder: Path
    data: Path | None = None
    calibrate: bool = True


def run_all(jobs: Sequence[TrialJob], options: RunOptions) -> list[Record]:
    """Score every method on every trial.

    The calibrations and the recordings are made first, each of them once. Then each method runs on
    each trial as a job of its own.

    Args:
        jobs: The jobs, the longest first.
        options: The options of the run.

    Returns:
        One record for each trial and method: trial, method, scores.
    """
    sensors = {job.trial.bootstrap().key(): job for job in jobs}
    recordings = {job.trial.recording_key(): job for job in jobs if job.trial.camera != V2E}
    parts = [part for job in jobs for part in _split(job)]
    progress = Progress(options, len(sensors) + len(recordings) + len(parts))
    with options.pool(len(parts)) as pool:
        progress.run(
            pool,
            make_input,
            [*sensors.values(), *(replace(job, calibrate=False) for job in recordings.values())],
        )
        return [record for some in progress.run(pool, run_job, parts) for record in some]


def _split(job: TrialJob) -> Iterator[TrialJob]:
    """Yield one job per tracker, with the output laws that use its estimates."""
    table = job.table()
    groups: dict[str, list[str]] = {}
    for name in job.methods:
        groups.setdefault(table[name].tracker if name in table else name, []).append(name)
    for names in groups.values():
        yield replace(job, methods=tuple(names))


def make_input(job: TrialJob) -> None:
    """Make the calibration or the recording that a job needs."""
    if job.calibrate:
        calibration_of(job.trial, job.folder, job.data)
    else:
        job.trial.record(job.folder)


def run_job(job: TrialJob) -> list[Record]:
    """Return the records of a job's methods; they are read from disk where they exist."""
    calibration = calibration_of(job.trial, job.folder, job.data)
    table = job.table()
    return [_score_method(job, table.get(name), name, calibration) for name in job.methods]


def _score_method(
    job: TrialJob, method: Method | None, name: str, calibration: Calibration
) -> Record:
    """Return the record of one method; None is the truth."""
    trial = job.trial
    about = {
        "trial": trial.key(),
        "calibration": calibration_digest(calibration, method.reads) if method else "",
        "method": method.key() if method else TRUTH,
        "kept_hz": KEPT_HZ,
    }
    key = digest(about)
    stem = f"{trial.case.replace('/', '_')}-{trial.scene}-{trial.serial}-{trial.seed}"
    file = job.folder / "predictions" / (method.tracker if method else TRUTH) / f"{stem}.npz"

    def scored() -> Record:
        events, truth = trial.open(job.folder, job.data)
        prediction = Prediction.kept(file, key, lambda: predict(method, events, calibration, truth))
        if method is not None and method.law is not None:
            prediction = apply_law(prediction, method.law())
        scores = point_scores(prediction, truth, trial.damaged_markers)
        return {"method": name, "trial": asdict(trial), "scores": scores}

    scoring = {"prediction": key, "law": method and method.law_settings, "scoring": code_digest()}
    return kept(job.folder / "scores" / name / f"{stem}.json", digest(scoring), scored)


def predict(
    method: Method | None,
    events: Iterable[EventPacket],
    calibration: Calibration,
    truth: GroundTruth,
) -> Prediction:
    """Return the estimates of a method on a recording; None gives the truth itself."""
    if method is not None:
        return method.track(events, calibration, KEPT_HZ)
    position_px = truth.marker_px.astype(np.float32)
    return Prediction(truth.t_us, position_px, position_px, truth.reference_px)
