"""Trials x methods -> predictions on disk -> scores; knows neither methods nor trials by name.

A prediction is kept under the digest of the recording, the calibration, the method's name and
configuration, and the source code behind it: what has not changed is not computed again, what has
changed is never taken for the new. One trial is one piece of work for one process.
"""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from spikingtac.config import digest
from spikingtac.experiments.calibrations import calibration_of
from spikingtac.experiments.ground_truth import GroundTruth
from spikingtac.experiments.methods import Method
from spikingtac.experiments.metrics import point_scores
from spikingtac.experiments.prediction import Prediction
from spikingtac.experiments.run_folder import write_json
from spikingtac.experiments.trials import Trial
from spikingtac.pipeline import follow
from spikingtac.types import Calibration, EventPacket

KEPT_HZ = 500.0
"""Rate at which predictions are kept and scored; faster trackers run at their rate all the same."""

SINGLE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that keep a library from starting threads of its own in every worker."""

Methods = Callable[[], dict[str, Method]]
Advance = Callable[[float], None]
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, slots=True)
class Work:
    """One trial and the methods that are asked about it.

    Attributes:
        trial: The trial.
        methods: Names of the methods.
        table: Importable function that returns the methods by name.
        folder: The run's folder.
        data: Folder of foreign recordings, or None.
    """

    trial: Trial
    methods: tuple[str, ...]
    table: Methods
    folder: Path
    data: Path | None = None


def run_all(
    works: Sequence[Work], workers: int, advance: Advance | None = None
) -> list[dict[str, Any]]:
    """Score every method on every trial.

    Args:
        works: What to do.
        workers: Processes, at most the number of CPUs.
        advance: Is told the share that is done, 0 to 1.

    Returns:
        One record for each trial and method: trial, method, scores.
    """
    calibrations = {
        json.dumps([asdict(work.trial.bootstrap()), str(work.data)], sort_keys=True): work
        for work in works
    }
    steps = len(calibrations) + len(works)
    _in_processes(prepare, list(calibrations.values()), workers, _part(advance, 0, steps))
    done = _in_processes(run_work, works, workers, _part(advance, len(calibrations), steps))
    return [record for records in done for record in records]


def prepare(work: Work) -> None:
    """Make the calibration that a piece of work needs."""
    calibration_of(work.trial, work.folder, work.data)


def run_work(work: Work) -> list[dict[str, Any]]:
    """Return the scores of one trial's methods, from disk where they are there."""
    trial, table = work.trial, work.table()
    calibration = calibration_of(trial, work.folder, work.data)
    base = {
        "trial": trial.key(),
        "calibration": digest(_rest(calibration)),
    }
    events: Iterable[EventPacket] | None = None
    truth: GroundTruth | None = None
    records = []
    for name in work.methods:
        method = table.get(name)
        key = digest({**base, "method": method.key() if method else name})
        stem = f"{trial.case.replace('/', '_')}-{trial.scene}-{trial.serial}-{trial.seed}"
        path = work.folder / "scores" / name / f"{stem}.json"
        record = _stored(path, key)
        if record is None:
            if events is None or truth is None:
                events, truth = trial.open(work.folder, work.data)
            file = work.folder / "predictions" / name / f"{stem}.npz"
            prediction = Prediction.load(file, key)
            if prediction is None:
                prediction = predict(method, events, calibration, truth)
                prediction.save(file, key)
            scores = point_scores(prediction, truth, trial.damaged_markers)
            record = {
                "key": key,
                "method": name,
                "trial": asdict(trial),
                "prediction": str(file.relative_to(work.folder)),
                "scores": scores,
            }
            write_json(path, record)
        records.append(record)
    return records


def predict(
    method: Method | None,
    events: Iterable[EventPacket],
    calibration: Calibration,
    truth: GroundTruth,
) -> Prediction:
    """Return what a method says about a recording; None is the method that knows the truth."""
    if method is None:
        return _truth_itself(truth)
    if method.before is not None:
        events = method.before(events, calibration)
    frames = follow(events, method.build(calibration), method.rate_hz)
    every = max(1, round(method.rate_hz / KEPT_HZ))
    return Prediction.collect(frames, calibration.reference_px, every)


def cpu_count() -> int:
    """Return the number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _truth_itself(truth: GroundTruth) -> Prediction:
    position_px = truth.marker_px.astype("float32")
    held = (position_px[..., 0] * 0).astype(bool)
    return Prediction(truth.t_us, position_px, position_px, held, truth.reference_px)


def _rest(calibration: Calibration) -> dict[str, Any]:
    return {
        "reference_px": calibration.reference_px.round(4).tolist(),
        "radius_px": calibration.radius_px.round(4).tolist(),
        "contrast": calibration.contrast or 0.0,
        "edge_px": calibration.edge_px or 0.0,
        "lag_us": calibration.lag_us or 0.0,
    }


def _stored(path: Path, key: str) -> dict[str, Any] | None:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if record.get("key") == key else None


def _part(advance: Advance | None, before: int, total: int) -> Advance:
    return lambda done: advance((before + done) / total) if advance else None


def _in_processes(
    function: Callable[[Work], T], works: Sequence[Work], workers: int, advance: Advance
) -> list[T]:
    for name in SINGLE_THREAD:
        os.environ.setdefault(name, "1")
    workers = max(1, min(workers, cpu_count(), len(works)))
    if workers == 1:
        out = []
        for number, work in enumerate(works, 1):
            out.append(function(work))
            advance(number)
        return out
    # Fresh interpreters: a fork would copy the locks of threads that it does not copy.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"))
    try:
        futures: list[Future[T]] = [pool.submit(function, work) for work in works]
        for number, future in enumerate(as_completed(futures), 1):
            future.result()
            advance(number)
        return [future.result() for future in futures]
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
