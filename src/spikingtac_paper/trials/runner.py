"""Run methods on trials: predictions on disk, then scores.

A prediction is stored under the digest of the recording, of the calibration fields that the method
reads, of its name and configuration, and of the source code behind it. Unchanged results are not
computed again, and outdated ones are never used. One method on one trial is one job.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from spikingtac import Calibration, follow
from spikingtac.config import digest
from spikingtac.types import EventPacket
from spikingtac_paper.harness.run import Progress, Record, RunOptions, code_digest, kept
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.methods import TRUTH, LawMethod, Method, apply_law
from spikingtac_paper.trials.metrics import point_scores
from spikingtac_paper.trials.prediction import Prediction
from spikingtac_paper.trials.trial import V2E, Trial, calibration_digest, calibration_of

KEPT_HZ = 500.0
"""Rate at which predictions are stored and scored, Hz. Faster trackers still run at their rate."""

Methods = Callable[[], Mapping[str, Method | LawMethod]]


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
    table: Methods
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
        method = table.get(name)
        groups.setdefault(method.of if isinstance(method, LawMethod) else name, []).append(name)
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
    job: TrialJob, method: Method | LawMethod | None, name: str, calibration: Calibration
) -> Record:
    trial, law = job.trial, method if isinstance(method, LawMethod) else None
    if isinstance(method, LawMethod):
        base = job.table()[method.of]
        assert isinstance(base, Method)
        method = base
    key = _key(trial, method, calibration)
    about = {"prediction": key, "law": law.key() if law else "", "scoring": code_digest()}
    stem = f"{trial.case.replace('/', '_')}-{trial.scene}-{trial.serial}-{trial.seed}"
    file = job.folder / "predictions" / (method.name if method else TRUTH) / f"{stem}.npz"

    def scored() -> Record:
        events, truth = trial.open(job.folder, job.data)
        prediction = Prediction.load(file, key)
        if prediction is None:
            prediction = predict(method, events, calibration, truth)
            prediction.save(file, key)
        if law:
            prediction = apply_law(prediction, law.law(), truth)
        scores = point_scores(prediction, truth, trial.damaged_markers)
        return {"method": name, "trial": asdict(trial), "scores": scores}

    return kept(job.folder / "scores" / name / f"{stem}.json", digest(about), scored)


def _key(trial: Trial, method: Method | None, calibration: Calibration) -> str:
    """Return the digest of everything that a prediction depends on; no method means the truth."""
    about = {
        "trial": trial.key(),
        "calibration": calibration_digest(calibration, method.reads) if method else "",
        "method": method.key() if method else TRUTH,
        "kept_hz": KEPT_HZ,
    }
    return digest(about)


def predict(
    method: Method | None,
    events: Iterable[EventPacket],
    calibration: Calibration,
    truth: GroundTruth,
) -> Prediction:
    """Return the estimates of a method on a recording; None gives the truth itself."""
    if method is None:
        return _truth_itself(truth)
    if method.before is not None:
        events = method.before(events, calibration)
    frames = follow(events, method.build(calibration), method.rate_hz)
    every = max(1, round(method.rate_hz / KEPT_HZ))
    return Prediction.collect(frames, calibration.reference_px, every)


def _truth_itself(truth: GroundTruth) -> Prediction:
    position_px = truth.marker_px.astype("float32")
    coasted = (position_px[..., 0] * 0).astype(bool)
    return Prediction(truth.t_us, position_px, position_px, coasted, truth.reference_px)
