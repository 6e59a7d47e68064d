"""Section V-B: stop the arm at contact, beside frame-based baselines (simulated).

The jobs are a quiet recording, an approach, and a motion without contact: a fast path for the
latter counts the false stops, everything else uses the whole twin. Each result is stored under the
digest of everything that it depends on. An interrupted run continues where it stopped, and results
of other code or settings are never used.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac import windows
from spikingtac.config import digest
from spikingtac.contact import DETECTORS, ContactDetector, DetectionConfig, make_detector
from spikingtac.types import EventPacket
from spikingtac_paper.collision.approach import (
    FIRST_FRAMES,
    FRAMES,
    PERIOD_US,
    ApproachRun,
    FrameSampler,
    Truth,
    approach,
    displacement_sum_px,
    exposures_us,
    measured_px,
    prepare,
    quiet_threshold_px,
    stop_at,
)
from spikingtac_paper.collision.scene import CollisionScene
from spikingtac_paper.collision.scoring import (
    ALL,
    FASTEST,
    METHODS,
    PRESETS,
    SLOW,
    SPEEDS,
    collision_rows,
)
from spikingtac_paper.free_motion.free_rig import FreeRig
from spikingtac_paper.harness.report import Report, dot_figure, lines_of, write_report
from spikingtac_paper.harness.run import (
    Progress,
    Record,
    RunOptions,
    code_digest,
    kept,
    load_windows,
    save_windows,
    select_methods,
)

BUDGET_PER_HOUR = 1.0  # Budget of false stops of every detector.
QUIET_SEED = 900_000  # First seed of the quiet recordings. No approach uses it.

# Milliseconds of the moving arm from which every threshold is computed (contract.md: a minute).
QUIET_STEPS = 60_000
CHUNK_STEPS = 10_000  # Milliseconds that are simulated at once: this bounds the memory.
STRETCH_STEPS = 100_000  # Length of one motion without contact, ms.

# Windows of a motion without contact before the detectors listen: as many as between a release
# and the listening of the next approach. Past motions leave the pixels' references displaced; the
# first swings after them remove that.
LEAD_WINDOWS = 900

# Numbers of the random streams of a trial's frames and of its starting place.
FRAME_STREAM, START_STREAM = 1, 2

# Methods that decide by frames -> their delay, us.
FRAME_DELAYS_US = {"frame_sampling": 0.0, "frame_plus_one": PERIOD_US}

# Methods that decide by the true first touch -> their delay, us. The paper's largest deviation of
# its frame baseline, 24.3 mm at 0.18 m/s, is 135 ms.
TOUCH_DELAYS_US = {"frame_paper": 135_000.0, "zero_delay": 0.0}


@dataclass(frozen=True, kw_only=True, slots=True)
class CollisionJob:
    """One approach, motion without contact or quiet recording, for one process.

    Attributes:
        folder: Folder of the run.
        scene: The scene.
        case: Case of the report; for a quiet recording empty.
        seed: Seed of everything random.
        methods: Names of the methods.
        speed_mm_s: Speed of an approach, mm/s; 0 for a motion without contact.
        patience_mm: Travel of the arm after the touch at which an approach ends, mm.
        required: Detectors whose decisions end an approach; empty means all of them.
    """

    folder: Path
    scene: CollisionScene
    case: str = ""
    seed: int = 0
    methods: tuple[str, ...] = ()
    speed_mm_s: float = 0.0
    patience_mm: float = 0.0
    required: tuple[str, ...] = ()

    @property
    def detectors(self) -> dict[str, ContactDetector]:
        """The detectors among the methods, each reset."""
        found = {name: _detector(self.folder, self.scene, name)
                 for name in self.methods if name in DETECTORS}  # fmt: skip
        for detector in found.values():
            detector.reset()
        return found


def run_job(job: CollisionJob) -> Record:
    """Return the record of a job; it is read from disk where it exists."""
    if not job.case:
        return _quiet_record(job.folder, job.scene)
    about = {**asdict(job), "folder": "", "scene": job.scene.digest(), "code": code_digest()}
    kind, work = ("approaches", _approach) if job.speed_mm_s else ("stretches", _free_motion)
    path = job.folder / kind / job.case.replace("/", "-") / f"{job.seed}.json"
    return kept(path, digest(about), lambda: {"case": job.case, "seed": job.seed, **work(job)})


def _quiet_paths(folder: Path, scene: CollisionScene) -> tuple[Path, Path]:
    stem = folder / "quiet" / digest({"scene": scene.digest(), "code": code_digest()})
    return stem.with_suffix(".npz"), stem.with_suffix(".json")


def _quiet_record(folder: Path, scene: CollisionScene) -> Record:
    """Record one minute of the moving arm, and learn the frame sampler's threshold from it."""
    events_path, record_path = _quiet_paths(folder, scene)

    def recorded() -> Record:
        free = scene.make_free_rig(QUIET_SEED + scene.serial, "rested")
        rest = free.image
        quiet: list[tuple[EventPacket, ...]] = []
        sums: list[float] = []
        rng = np.random.default_rng([QUIET_SEED, scene.serial])
        for packet, centers in _chunks(free, QUIET_STEPS):
            quiet += [(window,) for window in windows([packet], 1000)]
            sums += _frame_sums(centers, rng)
        save_windows(events_path, quiet)
        return {
            "reference_px": rest.center_px.tolist(),
            "radius_px": rest.radius_px.tolist(),
            "frame_threshold_px": quiet_threshold_px(sums),
        }

    return kept(record_path, record_path.stem, recorded)


def _chunks(free: FreeRig, steps: int) -> Iterator[tuple[EventPacket, Truth]]:
    """Yield the events of each chunk, and the true marker centres over it."""
    for first in range(0, steps, CHUNK_STEPS):
        packet, centers = free.advance(min(CHUNK_STEPS, steps - first))
        times = packet.t_start_us + np.float64(1000.0) * np.arange(1.0, len(centers) + 1)
        yield packet, (times, centers)


def _frame_sums(truth: Truth, rng: np.random.Generator) -> list[float]:
    """Return the displacement sums of the frames; the first frames give the initial coordinates."""
    times = exposures_us(rng.uniform(), int(truth[0][0]), int(truth[0][-1]))
    frames = measured_px(times, truth, rng)
    initial = frames[:FIRST_FRAMES].mean(axis=0)
    return displacement_sum_px(frames[FIRST_FRAMES:], initial).tolist()


@functools.lru_cache(maxsize=64)
def _detector(folder: Path, scene: CollisionScene, name: str) -> ContactDetector:
    """Return a detector that was calibrated on the scene's quiet recording."""
    record = _quiet_record(folder, scene)
    calibration = scene.calibration(record["reference_px"], record["radius_px"])
    config = DetectionConfig(false_alarms_per_hour=BUDGET_PER_HOUR)
    return make_detector(name, config, [calibration], load_windows(_quiet_paths(folder, scene)[0]))


def _approach(job: CollisionJob) -> Record:
    detectors = job.detectors
    rng = np.random.default_rng([job.seed, FRAME_STREAM])
    frames = None
    if any(name in FRAME_DELAYS_US for name in job.methods):
        threshold = _quiet_record(job.folder, job.scene)["frame_threshold_px"]
        frames = FrameSampler(threshold, rng.uniform(), rng)
    rig = job.scene.make_rig(job.seed)
    prepare(rig, job.speed_mm_s, np.random.default_rng([job.seed, START_STREAM]))
    required = frozenset(job.required or detectors)
    run = approach(rig, job.speed_mm_s, detectors, frames, required, job.patience_mm)
    costs = {name: {str(us): n for us, n in cost.items()} for name, cost in run.costs_us.items()}
    return {"methods": {name: _outcome(run, name) for name in job.methods}, "costs_us": costs}


def _outcome(run: ApproachRun, name: str) -> dict[str, float] | None:
    """Return the outcome of a method's decision, or None where it did not decide."""
    decided, delay_us = run.decided_us.get(name), 0.0
    if name in FRAME_DELAYS_US:
        decided, delay_us = run.decided_us.get(FRAMES), FRAME_DELAYS_US[name]
    elif name in TOUCH_DELAYS_US:
        decided, delay_us = run.touch.t_us, TOUCH_DELAYS_US[name]
    return None if decided is None else stop_at(run, decided + delay_us)


def _free_motion(job: CollisionJob) -> Record:
    """Count the false stops; after each the detector is reset, as after a real stop."""
    detectors = job.detectors
    free = job.scene.make_free_rig(job.seed, "random")
    rng = np.random.default_rng([job.seed, FRAME_STREAM])
    threshold = _quiet_record(job.folder, job.scene)["frame_threshold_px"]
    stops: Counter[str] = Counter({name: 0 for name in detectors})
    listened = 0
    for packet, centers in _chunks(free, STRETCH_STEPS):
        for number, window in enumerate(windows([packet], 1000), listened):
            for name, detector in detectors.items() if number >= LEAD_WINDOWS else ():
                if detector.update(window) is not None:
                    stops[name] += 1
                    detector.reset()
        listened += len(centers[0])
        beyond = np.array(_frame_sums(centers, rng)) > threshold
        stops[FRAMES] += int((np.diff(beyond.astype(np.int8), prepend=0) == 1).sum())
    return {"stops": dict(stops), "seconds": (listened - LEAD_WINDOWS) * 1e-3}


NAME = "collision"

# Cases whose tables the page shows first.
FIRST = tuple(f"{preset}/{case}" for preset in PRESETS for case in (ALL, FASTEST, SLOW))
STRETCH_SEED = 500_000  # First seed of the motions without contact. No approach uses it.

# A run ends 4 mm or 36 ms after the touch, whichever is later: this is one frame at least. The
# pads' linear fields are not valid beyond 8 mm.
FORCED_MM, FRAMES_S = 4.0, 0.036

# Travel after the touch at which the long series at 0.8 mm/s ends, mm: twice the largest aim.
SERIES_MM = 0.8
SAFETY = (
    "Not a safety function: no performance level (ISO 13849), and no replacement for the robot's "
    "protective stop (ISO 10218)."
)


@dataclass(frozen=True, kw_only=True, slots=True)
class RunSize:
    """The size of a run.

    Attributes:
        first_seed: First seed of the approaches.
        serials: Number of sensor specimens; the seeds use them in turn, each with its calibration.
        seeds: Number of approaches at each speed.
        fastest: Number of approaches at 0.18 m/s.
        slow: Number of approaches at 0.8 mm/s that give every method all the time it needs.
        series: Number of further approaches at 0.8 mm/s on the first preset, for the methods that
            found all of the slow ones within half of :data:`SERIES_MM`.
        stretches: Number of motions without contact per preset, 100 s each: ten hours in all.
    """

    first_seed: int = 0
    serials: int = 4
    seeds: int = 20
    fastest: int = 200
    slow: int = 60
    series: int = 940
    stretches: int = 364


QUICK = RunSize(serials=1, seeds=1, fastest=4, slow=2, series=0, stretches=8)


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    names = select_methods(METHODS, options.methods)
    size = replace(QUICK if options.quick else RunSize(), first_seed=options.seed)
    if options.seeds and not options.quick:
        size = replace(size, seeds=options.seeds)
    settings = options.begin(experiment=NAME, methods=names, **asdict(size))
    approaches, stretches = run_all(options, size, tuple(names))
    rows = collision_rows(approaches, stretches)
    scenes = {preset: CollisionScene(preset=preset) for preset in PRESETS}
    speeds = {f"{PRESETS[0]}/{speed}": speed for speed in SPEEDS}
    report = Report(
        title="Collision",
        settings=settings,
        about={
            "scenes": {preset: scene.resolved() for preset, scene in scenes.items()},
            "scene_digests": {preset: scene.digest() for preset, scene in scenes.items()},
            "quiet_s": QUIET_STEPS * 1e-3,
            "sensors": 1,
        },
        rows=rows,
        first=FIRST,
        findings=[*lines_of(rows, FIRST, ("default", "event_count")), SAFETY],
        figures=[
            (
                f"{metric} against the approach speed in m/s ({PRESETS[0]}, simulated); "
                "frame_paper contains the paper's 135 ms, frame_sampling nothing but 32 fps.",
                dot_figure(rows, speeds, names, metric),
            )
            for metric in ("deviation_mean_mm", "overshoot_mean_mm")
        ],
        methods={name: METHODS[name] for name in names},
    )
    return write_report(report, options, approaches=len(approaches))


def run_all(
    options: RunOptions, size: RunSize, names: tuple[str, ...]
) -> tuple[list[Record], list[Record]]:
    """Simulate every task of a run, or read its record from disk; approaches, free motions."""
    base = CollisionJob(folder=options.output, scene=CollisionScene(), methods=names)
    approaches, stretches = plan(size, base)
    scenes = list(dict.fromkeys(job.scene for job in (*approaches, *stretches)))
    total = len(scenes) + len(approaches) + len(stretches) + size.series
    progress = Progress(options, total)
    with options.pool(total) as pool:
        progress.run(pool, run_job, [replace(base, scene=scene) for scene in scenes])
        records = progress.run(pool, run_job, [*stretches, *approaches])
        free, touched = records[: len(stretches)], records[len(stretches) :]
        fast = fast_detectors(touched)
        kept = tuple(name for name in names if name not in DETECTORS or name in fast)
        later = [replace(job, methods=kept, required=fast) for job in series(size, base)]
        return touched + (progress.run(pool, run_job, later) if fast else []), free


def plan(size: RunSize, base: CollisionJob) -> tuple[list[CollisionJob], list[CollisionJob]]:
    """Return approaches, and motions without contact, the longest first."""
    counts = {SLOW: size.slow, **dict.fromkeys(SPEEDS, size.seeds), FASTEST: size.fastest}
    approaches = [
        job
        for speeds in ((SLOW,), SPEEDS)
        for preset in PRESETS
        for speed in speeds
        for job in _approaches(size, base, f"{preset}/{speed}", 0, counts[speed])
    ]
    first = STRETCH_SEED + 1_000 * size.first_seed
    stretches = [
        replace(base, scene=scene_of(size, preset, k), case=f"{preset}/{ALL}", seed=first + k)
        for preset in reversed(PRESETS)
        for k in range(size.stretches)
    ]
    return approaches, stretches


def series(size: RunSize, base: CollisionJob) -> list[CollisionJob]:
    """Return the long series at 0.8 mm/s."""
    jobs = _approaches(size, base, f"{PRESETS[0]}/{SLOW}", size.slow, size.series)
    return [replace(job, patience_mm=SERIES_MM) for job in jobs]


def _approaches(
    size: RunSize, base: CollisionJob, case: str, first: int, count: int
) -> list[CollisionJob]:
    """Return approaches of one case with consecutive seeds."""
    preset, _, speed = case.partition("/")
    speed_mm_s, first = 1000.0 * float(speed), size.first_seed + first
    patience_mm = max(FORCED_MM, speed_mm_s * FRAMES_S)
    base = replace(base, case=case, speed_mm_s=speed_mm_s, patience_mm=patience_mm)
    return [
        replace(base, scene=scene_of(size, preset, seed), seed=seed)
        for seed in range(first, first + count)
    ]


def scene_of(size: RunSize, preset: str, seed: int) -> CollisionScene:
    """Return the scene of contract.md with the sensor specimen of a seed."""
    return CollisionScene(preset=preset, serial=1 + seed % size.serials)


def fast_detectors(approaches: Sequence[Record]) -> tuple[str, ...]:
    """Return the detectors that found every slow approach within half of :data:`SERIES_MM`.

    Only these take part in the series; the others would decide after its end.
    """
    slow = [one for one in approaches if one["case"] == f"{PRESETS[0]}/{SLOW}"]
    late = {
        name
        for one in slow
        for name, outcome in one["methods"].items()
        if outcome is None or outcome["deviation_mm"] >= SERIES_MM / 2.0
    }
    return tuple(name for name in (slow[0]["costs_us"] if slow else ()) if name not in late)
