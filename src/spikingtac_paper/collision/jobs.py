"""The jobs of the collision experiment: a quiet recording, an approach, a motion without contact.

Each result is stored under the digest of everything that it depends on. An interrupted run
continues where it stopped, and results of other code or settings are never used.
"""

from __future__ import annotations

import functools
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import write_json
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import digest
from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.events.windows import windows
from spikingtac.types import EventPacket
from spikingtac_paper.baselines.frame_sampling import (
    FrameSampler,
    FrameSamplingConfig,
    displacement_sum_px,
    exposures_us,
    measured_px,
    quiet_threshold_px,
)
from spikingtac_paper.collision.approach_run import (
    FRAMES,
    ApproachRun,
    Observers,
    approach,
    prepare,
    stop_at,
)
from spikingtac_paper.collision.methods import collision_methods
from spikingtac_paper.collision.plan import (
    BUDGETS_PER_HOUR,
    QUIET_SEED,
    ApproachTask,
    FreeMotionTask,
)
from spikingtac_paper.collision.scene import CollisionScene
from spikingtac_paper.free_motion.free_rig import FreeRig
from spikingtac_paper.harness.fingerprint import code_digest
from spikingtac_paper.harness.quiet_windows import load_windows, save_windows
from spikingtac_paper.harness.records import Record, load_record

Centers = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Times ``(n,)``, us, and true marker centres ``(n, m, 2)``, px."""

QUIET_STEPS = 60_000
"""Milliseconds of the moving arm from which every threshold is computed (contract.md: a minute)."""
CHUNK_STEPS = 10_000
"""Milliseconds that are simulated at once: this bounds the memory."""
TRACED_SEEDS = 1
"""Approaches with a seed below this store their event counts, for the figure."""
LEAD_WINDOWS = 900
"""Windows of a motion without contact before the detectors listen: as many as between a release
and the listening of the next approach. Past motions leave the pixels' references displaced; the
first swings after them remove that."""
FRAME_STREAM, START_STREAM = 1, 2
"""Numbers of the random streams of a trial's frames and of its starting place."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CollisionJob:
    """One job for one process.

    Attributes:
        folder: Folder of the run.
        task: The approach or the motion without contact; a scene means its quiet recording.
        methods: Names of the methods.
        required: Detectors whose decisions end an approach; empty means all of them.
    """

    folder: Path
    task: CollisionScene | ApproachTask | FreeMotionTask
    methods: tuple[str, ...]
    required: tuple[str, ...] = ()


def run_job(job: CollisionJob) -> Record:
    """Return the record of a job; it is read from disk where it exists."""
    task = job.task
    if isinstance(task, CollisionScene):
        return _quiet_record(job.folder, task)
    kind = "approaches" if isinstance(task, ApproachTask) else "stretches"
    place = task.case.replace("/", "-")
    path = job.folder / kind / task.group / place / f"{task.seed}.json"
    key = job_key(task, job.methods, job.required)
    record = load_record(path, key)
    if record is None:
        result = (
            _run_approach(job, task)
            if isinstance(task, ApproachTask)
            else _run_free_motion(job, task)
        )
        record = {"key": key, "group": task.group, "case": task.case, "seed": task.seed, **result}
        write_json(path, record)
    return record


def job_key(
    task: ApproachTask | FreeMotionTask, methods: tuple[str, ...], required: tuple[str, ...]
) -> str:
    """Return the digest of everything that the result of a task depends on."""
    return digest(
        {
            "scene": task.scene.digest(),
            "seed": task.seed,
            "case": task.case,
            "group": task.group,
            "length": task.patience_mm if isinstance(task, ApproachTask) else task.steps,
            "methods": list(methods),
            "required": list(required),
            "code": code_digest(),
        }
    )


def _quiet_paths(folder: Path, scene: CollisionScene) -> tuple[Path, Path]:
    stem = folder / "quiet" / digest({"scene": scene.digest(), "code": code_digest()})
    return stem.with_suffix(".npz"), stem.with_suffix(".json")


def _quiet_record(folder: Path, scene: CollisionScene) -> Record:
    """Record one minute of the moving arm, and learn the frame sampler's threshold from it."""
    events_path, record_path = _quiet_paths(folder, scene)
    if record_path.is_file() and events_path.is_file():
        return json.loads(record_path.read_text(encoding="utf-8"))
    free = scene.make_free_rig(QUIET_SEED + scene.serial, "rested")
    calibration = scene.calibration(free)
    quiet: list[tuple[EventPacket, ...]] = []
    sums: list[float] = []
    config, rng = FrameSamplingConfig(), np.random.default_rng([QUIET_SEED, scene.serial])
    for packet, centers in _chunks(free, QUIET_STEPS):
        quiet += [(window,) for window in windows([packet], 1000)]
        sums += _frame_sums(config, centers, rng)
    save_windows(events_path, quiet)
    record: Record = {
        "reference_px": calibration.reference_px.tolist(),
        "radius_px": calibration.radius_px.tolist(),
        "frame_threshold_px": quiet_threshold_px(config, sums),
    }
    write_json(record_path, record)
    return record


def _chunks(free: FreeRig, steps: int) -> Iterator[tuple[EventPacket, Centers]]:
    """Yield the events of each chunk, and the true marker centres over it."""
    for first in range(0, steps, CHUNK_STEPS):
        (packet,), (centers,) = free.advance(min(CHUNK_STEPS, steps - first))
        times = packet.t_start_us + np.float64(1000.0) * np.arange(1.0, len(centers) + 1)
        yield packet, (times, centers)


def _frame_sums(
    config: FrameSamplingConfig, truth: Centers, rng: np.random.Generator
) -> list[float]:
    """Return the displacement sums of the frames; the first frames give the initial coordinates."""
    times = exposures_us(config, rng.uniform(), int(truth[0][0]), int(truth[0][-1]))
    frames = measured_px(config, times, truth, rng)
    initial = frames[: config.first_frames].mean(axis=0)
    return displacement_sum_px(frames[config.first_frames :], initial).tolist()


@functools.lru_cache(maxsize=64)
def _detector(folder: Path, scene: CollisionScene, name: str, budget: float) -> ContactDetector:
    """Return a detector that was calibrated on the scene's quiet recording."""
    record = _quiet_record(folder, scene)
    calibration = Calibration(
        reference_px=np.array(record["reference_px"]),
        radius_px=np.array(record["radius_px"]),
        grid=scene.rig.pad.skin.grid,
        size=scene.finger().optics.size,
    )
    quiet = _quiet(folder, scene)
    config = DetectionConfig(false_alarms_per_hour=budget)
    return make_detector(name, config, [calibration], quiet)


@functools.lru_cache(maxsize=2)
def _quiet(folder: Path, scene: CollisionScene) -> list[tuple[EventPacket, ...]]:
    return load_windows(_quiet_paths(folder, scene)[0])


def _detectors(
    job: CollisionJob, task: ApproachTask | FreeMotionTask
) -> dict[str, ContactDetector]:
    """Return the detectors of a job, reset; for the curve, each of them with several budgets."""
    known = collision_methods()
    names = [name for name in job.methods if known[name].sees == "events"]
    budgets = BUDGETS_PER_HOUR if task.group == "curve" else (BUDGETS_PER_HOUR[0],)
    out = {}
    for name in names:
        for budget in budgets:
            label = f"{name}@{budget:g}" if task.group == "curve" else name
            out[label] = _detector(job.folder, task.scene, name, budget)
            out[label].reset()
    return out


def _run_approach(job: CollisionJob, task: ApproachTask) -> Record:
    detectors = _detectors(job, task)
    rng = np.random.default_rng([task.seed, FRAME_STREAM])
    known = collision_methods()
    frames = None
    if any(known[name].sees == "frames" for name in job.methods):
        threshold = _quiet_record(job.folder, task.scene)["frame_threshold_px"]
        frames = FrameSampler(FrameSamplingConfig(), threshold, rng.uniform(), rng)
    required = frozenset(job.required or detectors)
    observers = Observers(
        detectors=detectors, frames=frames, required=required, patience_mm=task.patience_mm
    )
    rig = task.scene.make_rig(task.seed)
    prepare(rig, task.scene, task.speed_mm_s, np.random.default_rng([task.seed, START_STREAM]))
    run = approach(rig, task.scene, task.speed_mm_s, observers)
    labels = [*detectors, *(n for n in job.methods if known[n].sees != "events")]
    return {
        "methods": {label: _outcome(run, task, label) for label in labels},
        "costs_us": {
            name: {str(us): n for us, n in cost.items()} for name, cost in run.costs_us.items()
        },
        "touch_us": run.touch.t_us,
        "first_us": run.first_us,
        "counts": run.counts if task.seed < TRACED_SEEDS else [],
    }


def _outcome(run: ApproachRun, task: ApproachTask, label: str) -> dict[str, float] | None:
    """Return the outcome of a method's decision, or None where it did not decide."""
    method = collision_methods().get(label)
    sees = method.sees if method else "events"
    delay_us = method.delay_us if method else 0.0
    seen = {"touch": run.touch.t_us, "frames": run.decided_us.get(FRAMES)}
    decided = run.decided_us.get(label) if sees == "events" else seen[sees]
    if decided is None:
        return None
    stopped = stop_at(run, decided + delay_us, task.scene.direction)
    return {
        "deviation_mm": stopped.deviation_mm,
        "read_mm": stopped.read_mm,
        "overshoot_mm": stopped.overshoot_mm,
        "delay_us": decided + delay_us - run.touch.t_us,
    }


def _run_free_motion(job: CollisionJob, task: FreeMotionTask) -> Record:
    """Count the false stops; after each the detector is reset, as after a real stop."""
    detectors = _detectors(job, task)
    free = task.scene.make_free_rig(task.seed, "random")
    rng = np.random.default_rng([task.seed, FRAME_STREAM])
    config = FrameSamplingConfig()
    threshold = _quiet_record(job.folder, task.scene)["frame_threshold_px"]
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
