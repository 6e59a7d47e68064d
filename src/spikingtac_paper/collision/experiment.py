"""Section V-B: stop the arm at contact, beside frame-based baselines (simulated).

A fast path for motion without contact counts the false stops; everything else uses the whole twin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from spikingtac.contact import DETECTORS
from spikingtac_paper.collision.jobs import METHODS, QUIET_STEPS, CollisionJob, run_job
from spikingtac_paper.collision.scene import CollisionScene
from spikingtac_paper.collision.scoring import ALL, FASTEST, PRESETS, SLOW, SPEEDS, collision_rows
from spikingtac_paper.harness.report import Report, dot_figure, lines_of, write_report
from spikingtac_paper.harness.run import (
    Progress,
    Record,
    RunOptions,
    select_methods,
)

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

    @classmethod
    def of(cls, options: RunOptions) -> RunSize:
        """Return the size of a run; ``seeds`` sets the number of approaches at each speed."""
        first = options.seed
        if options.quick:
            return cls(
                first_seed=first, serials=1, seeds=1, fastest=4, slow=2, series=0, stretches=8
            )
        full = cls(first_seed=first)
        return replace(full, seeds=options.seeds or full.seeds)


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    names = select_methods(METHODS, options.methods)
    size = RunSize.of(options)
    settings = {"experiment": NAME, "quick": options.quick, "methods": names, **asdict(size)}
    options.begin(settings)
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
    return [
        replace(
            base,
            scene=scene_of(size, preset, seed),
            case=case,
            seed=seed,
            speed_mm_s=speed_mm_s,
            patience_mm=patience_mm,
        )
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
    found = slow[0]["costs_us"] if slow else {}
    return tuple(
        name
        for name in found
        if all(
            (outcome := one["methods"][name]) is not None
            and outcome["deviation_mm"] < SERIES_MM / 2.0
            for one in slow
        )
    )
