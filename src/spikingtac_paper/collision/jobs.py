"""The jobs of the collision experiment: a quiet recording, an approach, a motion without contact.

Each result is stored under the digest of everything that it depends on. An interrupted run
continues where it stopped, and results of other code or settings are never used.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from spikingtac import windows
from spikingtac.config import digest
from spikingtac.contact import DETECTORS, ContactDetector, DetectionConfig, make_detector
from spikingtac.types import EventPacket
from spikingtac_paper.collision.approach import (
    FRAMES,
    ApproachRun,
    Observers,
    approach,
    prepare,
    stop_at,
)
from spikingtac_paper.collision.frames import (
    FIRST_FRAMES,
    PERIOD_US,
    FrameSampler,
    Truth,
    displacement_sum_px,
    exposures_us,
    measured_px,
    quiet_threshold_px,
)
from spikingtac_paper.collision.scene import CollisionScene
from spikingtac_paper.free_motion.free_rig import FreeRig
from spikingtac_paper.harness.run import Record, code_digest, kept, load_windows, save_windows

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
ABOUT = {
    "event_count": "as published: events of 1 ms above a threshold, taken from the moving arm",
    "default": "sequential test of the signed rim events over nine time scales",
}

# Name -> one line about it: the contact detectors, then the baselines.
METHODS: dict[str, str] = {name: ABOUT.get(name, "a contact detector") for name in DETECTORS} | {
    "frame_sampling": "displacement sum over the markers at 32 fps, no other latency",
    "frame_plus_one": "the same with one more frame of latency",
    "frame_paper": "135 ms after the touch: the paper's baseline with its undocumented latency",
    "zero_delay": "a perfect sensor: decides at the true first touch, on the same arm",
}


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
        calibration = scene.calibration(free)
        quiet: list[tuple[EventPacket, ...]] = []
        sums: list[float] = []
        rng = np.random.default_rng([QUIET_SEED, scene.serial])
        for packet, centers in _chunks(free, QUIET_STEPS):
            quiet += [(window,) for window in windows([packet], 1000)]
            sums += _frame_sums(centers, rng)
        save_windows(events_path, quiet)
        return {
            "reference_px": calibration.reference_px.tolist(),
            "radius_px": calibration.radius_px.tolist(),
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
    calibration = scene.calibration_of(record["reference_px"], record["radius_px"])
    config = DetectionConfig(false_alarms_per_hour=BUDGET_PER_HOUR)
    return make_detector(name, config, [calibration], _quiet(folder, scene))


@functools.lru_cache(maxsize=2)
def _quiet(folder: Path, scene: CollisionScene) -> list[tuple[EventPacket, ...]]:
    return load_windows(_quiet_paths(folder, scene)[0])


def _approach(job: CollisionJob) -> Record:
    detectors = job.detectors
    rng = np.random.default_rng([job.seed, FRAME_STREAM])
    frames = None
    if any(name in FRAME_DELAYS_US for name in job.methods):
        threshold = _quiet_record(job.folder, job.scene)["frame_threshold_px"]
        frames = FrameSampler(threshold, rng.uniform(), rng)
    observers = Observers(
        detectors=detectors,
        frames=frames,
        required=frozenset(job.required or detectors),
        patience_mm=job.patience_mm,
    )
    rig = job.scene.make_rig(job.seed)
    prepare(rig, job.speed_mm_s, np.random.default_rng([job.seed, START_STREAM]))
    run = approach(rig, job.speed_mm_s, observers)
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
            if number >= LEAD_WINDOWS:
                _listen(detectors, window, stops)
        listened += len(centers[0])
        beyond = np.array(_frame_sums(centers, rng)) > threshold
        stops[FRAMES] += int((np.diff(beyond.astype(np.int8), prepend=0) == 1).sum())
    return {"stops": dict(stops), "seconds": (listened - LEAD_WINDOWS) * 1e-3}


def _listen(
    detectors: dict[str, ContactDetector], window: EventPacket, stops: Counter[str]
) -> None:
    for name, detector in detectors.items():
        if detector.update(window) is not None:
            stops[name] += 1
            detector.reset()
