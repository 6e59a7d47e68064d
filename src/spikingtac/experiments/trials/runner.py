"""Trials x methods -> predictions on disk -> scores; knows neither methods nor trials by name.

A prediction is kept under the digest of the recording, of what the method reads of the calibration,
of its name and configuration, and of the source code behind it: what has not changed is not
computed again, what has changed is never taken for the new. One method on one trial is one piece of
work for one process.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import digest
from spikingtac.experiments.harness.fingerprint import code_digest, modules_behind
from spikingtac.experiments.harness.run_folder import write_json
from spikingtac.experiments.harness.worker_pool import worker_pool
from spikingtac.experiments.trials.calibrations import calibration_digest, calibration_of
from spikingtac.experiments.trials.ground_truth import GroundTruth
from spikingtac.experiments.trials.laws import LawMethod, under_law
from spikingtac.experiments.trials.methods import TRUTH, Method
from spikingtac.experiments.trials.metrics import point_scores
from spikingtac.experiments.trials.prediction import Prediction
from spikingtac.experiments.trials.trials import V2E, Trial
from spikingtac.pipeline.follow import follow
from spikingtac.types import EventPacket

KEPT_HZ = 500.0
"""Rate at which predictions are kept and scored; faster trackers run at their rate all the same."""

Methods = Callable[[], Mapping[str, Method | LawMethod]]
Advance = Callable[[float], None]


SCORING = ("experiments/trials/metrics.py", "experiments/trials/ground_truth.py")
"""Where scores come from: changing it scores the kept predictions again."""


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
    works: Sequence[Work], workers: int | None, advance: Advance | None = None
) -> list[dict[str, Any]]:
    """Score every method on every trial.

    First the calibrations and recordings are made, each of them once, then each method is asked
    about each trial on its own: no process waits for another one's long list.

    Args:
        works: What to do, the longest first.
        workers: Processes, at most one for every CPU, which is also what None means.
        advance: Is told the share that is done, 0 to 1.

    Returns:
        One record for each trial and method: trial, method, scores.
    """
    sensors = {work.trial.bootstrap().key(): work for work in works}
    films = {work.trial.recording_key(): work for work in works if work.trial.camera != V2E}
    single = [part for work in works for part in _parts(work)]
    total = len(sensors) + len(films) + len(single)
    with worker_pool(workers, len(single)) as pool:
        made = [pool.submit(prepare, work) for work in sensors.values()]
        made += [pool.submit(film, work) for work in films.values()]
        for number, one in enumerate(as_completed(made), 1):
            one.result()
            _tell(advance, number / total)
        asked = [pool.submit(run_work, work) for work in single]
        for number, future in enumerate(as_completed(asked), len(made) + 1):
            future.result()
            _tell(advance, number / total)
        return [record for future in asked for record in future.result()]


def _parts(work: Work) -> Iterator[Work]:
    """Yield one piece of work per tracker, with the laws that take their estimates from it."""
    table = work.table()
    groups: dict[str, list[str]] = {}
    for name in work.methods:
        method = table.get(name)
        groups.setdefault(method.of if isinstance(method, LawMethod) else name, []).append(name)
    for names in groups.values():
        yield replace(work, methods=tuple(names))


def prepare(work: Work) -> None:
    """Make the calibration that a piece of work needs."""
    calibration_of(work.trial, work.folder, work.data)


def film(work: Work) -> None:
    """Make the recording that a piece of work needs."""
    work.trial.record(work.folder)


def run_work(work: Work) -> list[dict[str, Any]]:
    """Return the scores of one trial's methods, from disk where they are there."""
    calibration = calibration_of(work.trial, work.folder, work.data)
    table = work.table()
    return [_asked(work, table.get(name), name, calibration) for name in work.methods]


def _asked(
    work: Work, method: Method | LawMethod | None, name: str, calibration: Calibration
) -> dict[str, Any]:
    trial, law = work.trial, method if isinstance(method, LawMethod) else None
    if isinstance(method, LawMethod):
        base = work.table()[method.of]
        assert isinstance(base, Method)
        method = base
    key = _key(trial, method, calibration)
    scoring = code_digest(modules_behind(SCORING))
    score_key = digest({"prediction": key, "law": law.key() if law else "", "scoring": scoring})
    stem = f"{trial.case.replace('/', '_')}-{trial.scene}-{trial.serial}-{trial.seed}"
    path = work.folder / "scores" / name / f"{stem}.json"
    record = _stored(path, score_key)
    if record is not None:
        return record
    events, truth = trial.open(work.folder, work.data)
    file = work.folder / "predictions" / (method.name if method else TRUTH) / f"{stem}.npz"
    prediction = Prediction.load(file, key)
    if prediction is None:
        prediction = predict(method, events, calibration, truth)
        prediction.save(file, key)
    if law:
        prediction = under_law(prediction, law.law(), truth)
    record = {
        "key": score_key,
        "method": name,
        "trial": asdict(trial),
        "prediction": str(file.relative_to(work.folder)),
        "scores": point_scores(prediction, truth, trial.damaged_markers),
    }
    write_json(path, record)
    return record


def _key(trial: Trial, method: Method | None, calibration: Calibration) -> str:
    """Return what a prediction is kept under; without a method it is the truth's."""
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
    """Return what a method says about a recording; None is the method that knows the truth."""
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


def _stored(path: Path, key: str) -> dict[str, Any] | None:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if record.get("key") == key else None


def _tell(advance: Advance | None, share: float) -> None:
    if advance:
        advance(share)
