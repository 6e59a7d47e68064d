"""One piece of the collision experiment for one process: a calibration, an approach, a stretch.

What is done is kept under the digest of everything it depends on: an interrupted run goes on where
it was, and what was made by other code or settings is never taken for the new.
"""

from __future__ import annotations

import functools
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.baselines.frame_sampling import (
    FrameSampler,
    FrameSamplingConfig,
    displacement_sum_px,
    exposures_us,
    quiet_threshold_px,
    seen_px,
)
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import digest
from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.events.windows import windows
from spikingtac.experiments.collision.approach_run import (
    FRAMES,
    ApproachRun,
    Watchers,
    approach,
    prepare,
    stop_at,
)
from spikingtac.experiments.collision.methods import collision_methods
from spikingtac.experiments.collision.plan import (
    BUDGETS_PER_HOUR,
    QUIET_SEED,
    Approached,
    Stretch,
)
from spikingtac.experiments.collision.scene import CollisionScene
from spikingtac.experiments.harness.fingerprint import code_digest
from spikingtac.experiments.harness.quiet_windows import load_windows, save_windows
from spikingtac.experiments.harness.run_folder import write_json
from spikingtac.types import EventPacket

Record = dict[str, Any]
Centers = tuple[NDArray[np.float64], NDArray[np.float64]]

QUIET_STEPS = 60_000
"""Milliseconds of the moving arm from which every threshold is taken: the minute that is asked."""
CHUNK_STEPS = 10_000
CODE = (
    "sim", "contact", "robot/approach.py", "baselines/frame_sampling.py", "configs/cameras",
    *(f"experiments/collision/{part}.py" for part in ("scene", "approach_run", "work")),
)  # fmt: skip
"""What a result depends on."""
LEAD_WINDOWS = 900
"""Windows of a stretch before anything listens: as long as between a release and the listening of
the next approach. The references begin as past motions left them; the first swings use that up."""
FRAME_STREAM, START_STREAM = 1, 2
"""Numbers of the random streams of a trial's frames and of its starting place."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Work:
    """One piece of work.

    Attributes:
        folder: The run's folder.
        task: What is to be done; a scene is its calibration.
        methods: Names of the methods.
        enough: Detectors whose decisions end an approach; empty is all of them.
    """

    folder: Path
    task: CollisionScene | Approached | Stretch
    methods: tuple[str, ...]
    enough: tuple[str, ...] = ()


def run_work(work: Work) -> Record:
    """Return the record of a piece of work, from disk where it is there."""
    task = work.task
    if isinstance(task, CollisionScene):
        return _calibrated(work.folder, task)
    kind = "approaches" if isinstance(task, Approached) else "stretches"
    place = task.case.replace("/", "-")
    path = work.folder / kind / task.group / place / f"{task.seed}.json"
    key = _key(task, work.methods, work.enough)
    record = _stored(path, key)
    if record is None:
        done = _approached(work, task) if isinstance(task, Approached) else _stretched(work, task)
        record = {"key": key, "group": task.group, "case": task.case, "seed": task.seed, **done}
        write_json(path, record)
    return record


def _key(task: Approached | Stretch, methods: tuple[str, ...], enough: tuple[str, ...]) -> str:
    about = {
        "scene": task.scene.digest(),
        "seed": task.seed,
        "case": task.case,
        "group": task.group,
        "length": task.patience_mm if isinstance(task, Approached) else task.steps,
        "methods": list(methods),
        "enough": list(enough),
        "code": code_digest(CODE),
    }
    return digest(about)


def _stored(path: Path, key: str) -> Record | None:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if record.get("key") == key else None


def _quiet_paths(folder: Path, scene: CollisionScene) -> tuple[Path, Path]:
    stem = folder / "quiet" / digest({"scene": scene.digest(), "code": code_digest(CODE)})
    return stem.with_suffix(".npz"), stem.with_suffix(".json")


def _calibrated(folder: Path, scene: CollisionScene) -> Record:
    """Record a minute of the moving arm; learn what the frames show in it."""
    events, about = _quiet_paths(folder, scene)
    if about.is_file() and events.is_file():
        return json.loads(about.read_text(encoding="utf-8"))
    free = scene.make_free_rig(QUIET_SEED + scene.serial, "rested")
    calibration = scene.calibration(free)
    kept: list[tuple[EventPacket, ...]] = []
    sums: list[float] = []
    config, rng = FrameSamplingConfig(), np.random.default_rng([QUIET_SEED, scene.serial])
    for packet, centers in _chunks(free, QUIET_STEPS):
        kept += [(window,) for window in windows([packet], 1000)]
        sums += _frame_sums(config, centers, rng)
    events.parent.mkdir(parents=True, exist_ok=True)
    save_windows(events, kept)
    record: Record = {
        "reference_px": calibration.reference_px.tolist(),
        "radius_px": calibration.radius_px.tolist(),
        "frame_threshold_px": quiet_threshold_px(config, sums),
    }
    write_json(about, record)
    return record


def _chunks(free: Any, steps: int) -> Iterator[tuple[EventPacket, Centers]]:
    """Yield the events of stretches and the true marker centres over them."""
    for first in range(0, steps, CHUNK_STEPS):
        (packet,), (centers,) = free.stretch(min(CHUNK_STEPS, steps - first))
        times = packet.t_start_us + 1000.0 * np.arange(1, len(centers) + 1)
        yield packet, (times, centers)


def _frame_sums(
    config: FrameSamplingConfig, truth: Centers, rng: np.random.Generator
) -> list[float]:
    """Return the displacement sums of a stretch; its first frames give the initial coordinates."""
    times = exposures_us(config, rng.uniform(), int(truth[0][0]), int(truth[0][-1]))
    frames = seen_px(config, times, truth, rng)
    initial = frames[: config.first_frames].mean(axis=0)
    return displacement_sum_px(frames[config.first_frames :], initial).tolist()


@functools.lru_cache(maxsize=64)
def _detector(folder: Path, scene: CollisionScene, name: str, budget: float) -> ContactDetector:
    """Return a detector, calibrated on the scene's minute without contact."""
    about = _calibrated(folder, scene)
    calibration = Calibration(
        reference_px=np.array(about["reference_px"]),
        radius_px=np.array(about["radius_px"]),
        grid=scene.rig.pad.skin.grid,
        size=scene.finger().optics.size,
    )
    quiet = _quiet(folder, scene)
    config = DetectionConfig(false_alarms_per_hour=budget)
    return make_detector(name, config, [calibration], quiet)


@functools.lru_cache(maxsize=2)
def _quiet(folder: Path, scene: CollisionScene) -> list[tuple[EventPacket, ...]]:
    return load_windows(_quiet_paths(folder, scene)[0])


def _detectors(work: Work, task: Approached | Stretch) -> dict[str, ContactDetector]:
    """Return the detectors of a piece of work, reset; several budgets of each for the curve."""
    known = collision_methods()
    names = [name for name in work.methods if known[name].sees == "events"]
    budgets = BUDGETS_PER_HOUR if task.group == "curve" else (BUDGETS_PER_HOUR[0],)
    out = {}
    for name in names:
        for budget in budgets:
            label = f"{name}@{budget:g}" if task.group == "curve" else name
            out[label] = _detector(work.folder, task.scene, name, budget)
            out[label].reset()
    return out


def _approached(work: Work, task: Approached) -> Record:
    detectors = _detectors(work, task)
    rng = np.random.default_rng([task.seed, FRAME_STREAM])
    known = collision_methods()
    frames = None
    if any(known[name].sees == "frames" for name in work.methods):
        threshold = _calibrated(work.folder, task.scene)["frame_threshold_px"]
        frames = FrameSampler(FrameSamplingConfig(), threshold, rng.uniform(), rng)
    enough = frozenset(work.enough or detectors)
    watchers = Watchers(
        detectors=detectors, frames=frames, enough=enough, patience_mm=task.patience_mm
    )
    rig = task.scene.make_rig(task.seed)
    prepare(rig, task.scene, task.speed_mm_s, np.random.default_rng([task.seed, START_STREAM]))
    passage = approach(rig, task.scene, task.speed_mm_s, watchers)
    labels = [*detectors, *(n for n in work.methods if known[n].sees != "events")]
    return {
        "methods": {label: _outcome(passage, task, label) for label in labels},
        "costs_us": {
            name: {str(us): n for us, n in cost.items()} for name, cost in passage.costs_us.items()
        },
        "touch_us": passage.touch.t_us,
        "first_us": passage.first_us,
        "counts": passage.counts if task.seed < TRACED else [],
    }


TRACED = 1
"""Approaches below this seed keep their counts, for the figure."""


def _outcome(passage: ApproachRun, task: Approached, label: str) -> dict[str, float] | None:
    """Return what a method's decision leads to; None where it did not decide."""
    method = collision_methods().get(label)
    sees = method.sees if method else "events"
    delay_us = method.delay_us if method else 0.0
    seen = {"touch": passage.touch.t_us, "frames": passage.decided_us.get(FRAMES)}
    decided = passage.decided_us.get(label) if sees == "events" else seen[sees]
    if decided is None:
        return None
    stopped = stop_at(passage, decided + delay_us, task.scene.direction)
    return {
        "deviation_mm": stopped.deviation_mm,
        "read_mm": stopped.read_mm,
        "overshoot_mm": stopped.overshoot_mm,
        "delay_us": decided + delay_us - passage.touch.t_us,
    }


def _stretched(work: Work, task: Stretch) -> Record:
    """Count false stops; after each the detector begins anew, as after a real stop."""
    detectors = _detectors(work, task)
    free = task.scene.make_free_rig(task.seed, "random")
    rng = np.random.default_rng([task.seed, FRAME_STREAM])
    config = FrameSamplingConfig()
    threshold = _calibrated(work.folder, task.scene)["frame_threshold_px"]
    stops: Counter[str] = Counter({name: 0 for name in detectors})
    listened = 0
    for packet, centers in _chunks(free, task.steps):
        for number, window in enumerate(windows([packet], 1000), listened):
            if number >= LEAD_WINDOWS:
                _listen(detectors, window, stops)
        listened += len(centers[0])
        beyond = np.array(_frame_sums(config, centers, rng)) > threshold
        stops[FRAMES] += int((np.diff(beyond.astype(np.int8), prepend=0) == 1).sum())
    return {"stops": dict(stops), "seconds": (listened - LEAD_WINDOWS) * 1e-3}


def _listen(
    detectors: dict[str, ContactDetector], window: EventPacket, stops: Counter[str]
) -> None:
    for name, detector in detectors.items():
        if detector.update(window) is not None:
            stops[name] += 1
            detector.reset()
