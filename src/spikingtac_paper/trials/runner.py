"""Run methods on trials, and score their estimates.

Scores are stored under the digest of the recording, of the calibration and of the source code:
unchanged results are not computed again, and outdated ones are never used. One tracker on one trial
is one job.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac import Calibration
from spikingtac.config import digest
from spikingtac.errors import SpikingTacError
from spikingtac_paper.harness.run import Progress, Record, RunOptions, code_digest, kept
from spikingtac_paper.trials.methods import Method, apply_law
from spikingtac_paper.trials.metrics import point_scores
from spikingtac_paper.trials.trajectories import GroundTruth, Prediction
from spikingtac_paper.trials.trial import (
    RecordedTrial,
    Trial,
    calibration_of,
)

# Rate at which predictions are scored, Hz. Faster trackers still run at their rate.
KEPT_HZ = 500.0


def scores_against_truth(
    prediction: Prediction, truth: GroundTruth | Path, _calibration: Calibration, trial: Any
) -> dict[str, float]:
    """Return the metrics of point tracking; damaged markers are not scored."""
    known = GroundTruth.load(truth) if isinstance(truth, Path) else truth
    return point_scores(prediction, known, getattr(trial, "damaged_markers", ()))


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialJob:
    """One trial and the methods that run on it.

    Attributes:
        trial: The trial.
        methods: Names of the methods.
        table: Importable function that returns the methods by name.
        folder: Folder of the run.
        data: Folder of recordings from elsewhere, or None.
        score: Importable function from prediction, truth, calibration and trial to the scores.
        kept_hz: Rate at which predictions are scored, Hz.
        calibrate: Whether the input to make is the calibration, or the recording.
    """

    trial: Trial | RecordedTrial
    methods: tuple[str, ...]
    table: Callable[[], Mapping[str, Method]]
    folder: Path
    data: Path | None = None
    score: Callable[..., dict[str, float]] = scores_against_truth
    kept_hz: float = KEPT_HZ
    calibrate: bool = True


def run_all(
    jobs: Sequence[TrialJob], options: RunOptions, refused: dict[str, str] | None = None
) -> list[Record]:
    """Score every method on every trial.

    The calibrations and the recordings are made first, each of them once. Then each method runs on
    each trial as a job of its own.

    Args:
        jobs: The jobs, the longest first.
        options: The options of the run.
        refused: Takes (case, reason) of each calibration that fails, whose trials are then left
            out. Such an error is raised unless given.

    Returns:
        One record for each trial and method: trial, method, scores.
    """
    sensors = {job.trial.calibration_path(job.folder): job for job in jobs}
    recordings = {
        job.trial.recording_key(): replace(job, calibrate=False)
        for job in jobs
        if isinstance(job.trial, Trial)
    }
    count = len(sensors) + len(recordings) + sum(len(job.methods) for job in jobs)
    progress = Progress(options, count)
    with options.pool(count) as pool:
        inputs = [*sensors.values(), *recordings.values()]
        errors = progress.run(pool, make_input, inputs)
        failed = dict(zip(sensors, errors, strict=False))
        parts = []
        for job in jobs:
            error = failed[job.trial.calibration_path(job.folder)]
            if error is None:
                parts += _split(job)
            elif refused is None:
                raise error
            else:
                refused[job.trial.case] = f"not calibrated, {error}"
        return [record for some in progress.run(pool, run_job, parts) for record in some]


def _split(job: TrialJob) -> Iterator[TrialJob]:
    """Yield one job per tracker, with the output laws that use its estimates."""
    table = job.table()
    groups: dict[str, list[str]] = {}
    for name in job.methods:
        groups.setdefault(table[name].tracker if name in table else name, []).append(name)
    for names in groups.values():
        yield replace(job, methods=tuple(names))


def make_input(job: TrialJob) -> SpikingTacError | None:
    """Make the calibration or the recording that a job needs; return why that failed."""
    try:
        if job.calibrate:
            calibration_of(job.trial, job.folder, job.data)
        elif isinstance(job.trial, Trial):
            job.trial.record(job.folder)
    except SpikingTacError as error:
        return error
    return None


def run_job(job: TrialJob) -> list[Record]:
    """Return the records of a job's methods, which use the estimates of one tracker."""
    calibration = calibration_of(job.trial, job.folder, job.data)
    table = job.table()
    # Estimated at most once, and only where a score is not on disk.
    predicted = functools.cache(lambda: _predicted(job, table.get(job.methods[0]), calibration))
    return [_scored(job, name, table.get(name), predicted, calibration) for name in job.methods]


def _predicted(job: TrialJob, method: Method | None, calibration: Calibration) -> Prediction:
    """Return the estimates of a tracker; None is the truth."""
    events, truth = job.trial.open(job.folder, job.data)
    if method is not None:
        return method.track(events, calibration, job.kept_hz)
    truth = GroundTruth.load(truth) if isinstance(truth, Path) else truth
    position_px = truth.marker_px.astype(np.float32)
    return Prediction(truth.t_us, position_px, position_px, truth.reference_px)


def _scored(
    job: TrialJob,
    name: str,
    method: Method | None,
    predicted: Callable[[], Prediction],
    calibration: Calibration,
) -> Record:
    """Return the record of one method; it is read from disk where it exists."""
    trial = job.trial

    def record() -> Record:
        prediction = predicted()
        if method is not None and method.law is not None:
            prediction = apply_law(prediction, method.law())
        truth = trial.open(job.folder, job.data)[1]
        scores = job.score(prediction, truth, calibration, trial)
        return {"method": name, "trial": asdict(trial), "scores": scores}

    about = {
        "trial": trial.key(),
        "calibration": trial.calibration_path(job.folder).name,
        "kept_hz": job.kept_hz,
        "code": code_digest(),
    }
    file = f"{trial.case.replace('/', '_')}-{trial.key()}.json"
    return kept(job.folder / "scores" / name / file, digest(about), record)
