"""Section V-C: centre and radius of ten holes by touch, beside the paper's table (simulated).

The jobs are a calibration per seed, then two searches per hole. In a search each touch depends on
all touches before. Both searches of a hole are therefore made once, and every method and both
repeatabilities of the arm are evaluated on their touches.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.contact import ContactDetector, DetectionConfig, make_detector
from spikingtac.errors import SearchError
from spikingtac.geometry import TravelModel
from spikingtac.robot import (
    ArmState,
    Prober,
    Touched,
    probe_hole,
)
from spikingtac.sim import (
    CROSS,
    DEFAULT,
    PLANNING_MM,
    SIGMAS_MM,
    STYLES,
    HoleSite,
    RecordingProber,
    prober_for,
    quiet_windows,
    touch_flat_wall,
    touch_flat_walls,
    travel_of,
)
from spikingtac.types import FloatArray
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
from spikingtac_paper.holes.cross_search import cross_search
from spikingtac_paper.holes.scoring import METHODS, MOST_CONTACTS, RADII_MM, hole_rows, trial_of

# Touches in each direction of a calibration, at most 10 (contract.md). The calibration's error is
# common to all contacts of a seed: with five touches in each of twelve directions it was a
# seventh of the variance of a centre from twelve contacts (measured).
CYCLES = {CROSS: 4, DEFAULT: 10}

# The same in a quick run, which has one seed and hence one calibration.
QUICK_CYCLES = {CROSS: 2, DEFAULT: 3}
DETECTOR = "default"  # Contact detector of all searches.

# Noise seeds of a hole and of a calibration, per experiment seed.
HOLE_SEEDS, CALIBRATION_SEEDS = 1000, 500

# Numbers of the random streams of the readings and of the contacts before.
CALIBRATION_STREAM, SEARCH_STREAM, PAST_STREAM = 4, 5, 6


@dataclass(frozen=True, slots=True)
class HoleJob:
    """One hole of one seed; ``hole`` None means the seed's calibration.

    Attributes:
        folder: Folder of the run.
        seed: Seed of grasp, plate and noise.
        hole: Index into :data:`RADII_MM`.
        quick: Whether the calibration uses :data:`QUICK_CYCLES`.
    """

    folder: Path
    seed: int
    hole: int | None = None
    quick: bool = False

    @property
    def cycles(self) -> dict[str, int]:
        """Touches in each direction of the calibration, by style."""
        return QUICK_CYCLES if self.quick else CYCLES

    @property
    def path(self) -> Path:
        """File of the touches."""
        name = "calibration" if self.hole is None else f"hole-{self.hole + 1}"
        return self.folder / "touches" / f"seed-{self.seed}" / f"{name}.json"

    @property
    def quiet_path(self) -> Path:
        """File of the quiet windows of the seed."""
        return self.path.with_name("quiet.npz")

    def key(self) -> str:
        """Return the digest of the code and the settings that the touches depend on."""
        return f"{code_digest()}-{DETECTOR}-{'quick' if self.quick else 'full'}"


def run_calibration(job: HoleJob) -> Record:
    """Touch a flat wall in every direction of the searches, or read these touches from disk."""

    def touched() -> Record:
        site = HoleSite(job.seed, CALIBRATION_SEEDS + HOLE_SEEDS * job.seed)
        quiet = quiet_windows(site)
        save_windows(job.quiet_path, quiet)
        detector = make_detector(DETECTOR, DetectionConfig(), [site.calibration], quiet)
        rng = np.random.default_rng([job.seed, PAST_STREAM])
        before_cross = functools.partial(_make_past_contact, site, detector, rng)
        record: Record = {"seed": job.seed}
        for style in STYLES:
            plain = prober_for(site, detector, style)
            prober = RecordingProber(plain, [job.seed, CALIBRATION_STREAM])
            touch_flat_walls(site, prober, style, job.cycles[style], before_cross)
            record[style] = prober.stored
        return record

    return kept(job.path, job.key(), touched)


def run_searches(job: HoleJob) -> Record:
    """Search one hole in both styles, or read the touches from disk."""
    return kept(job.path, job.key(), functools.partial(_searched, job))


def _searched(job: HoleJob) -> Record:
    assert job.hole is not None
    calibration = run_calibration(replace(job, hole=None))
    trial = trial_of(job.seed, job.hole)
    site = HoleSite(job.seed, HOLE_SEEDS * job.seed + job.hole)
    quiet = load_windows(job.quiet_path)
    detector = make_detector(DETECTOR, DetectionConfig(), [site.calibration], quiet)
    _make_past_contact(site, detector, np.random.default_rng([job.seed, PAST_STREAM, job.hole]))
    record: Record = {"seed": job.seed, "hole": job.hole}
    for style in STYLES:
        site.set_wall(trial.wall, trial.start_mm)
        travel = travel_of(calibration[style], PLANNING_MM)
        seed = [job.seed, SEARCH_STREAM, job.hole]
        prober = RecordingProber(prober_for(site, detector, style), seed)
        found: dict[str, Any] = {"used": [], "error": None}
        try:
            used = _search(style, prober, trial.start_mm, travel)
            found["used"] = prober.numbers(used)
        except SearchError as failure:
            found["error"] = str(failure)
        record[style] = {"touches": prober.stored, **found}
        while site.rig.arm.state() is ArmState.MOVING:
            site.rig.wait(0.01)
    return record


def _search(
    style: str, prober: Prober, start_mm: FloatArray, travel: TravelModel
) -> Sequence[Touched]:
    if style == CROSS:
        return cross_search(prober, start_mm, travel)
    return probe_hole(prober, travel, start_mm, MOST_CONTACTS).touches


def _make_past_contact(site: HoleSite, detector: ContactDetector, rng: np.random.Generator) -> None:
    """Touch another wall and wait a second: the pixels' references keep traces of this contact."""
    touch_flat_wall(site, prober_for(site, detector, DEFAULT), 2.0 * np.pi * rng.uniform())
    site.rig.wait(1.0)


NAME = "holes"
FULL_SEEDS = 20  # Seeds of a full run.
FIRST = tuple(f"{prefix}/all" for prefix in SIGMAS_MM)  # Cases whose tables the page shows first.


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    names = select_methods(METHODS, options.methods)
    count = options.seeds or (1 if options.quick else FULL_SEEDS)
    settings = options.begin(
        experiment=NAME, first_seed=options.seed, seeds=count, methods=names, detector=DETECTOR
    )
    calibrations, records = touch_all(options, range(options.seed, options.seed + count))
    rows = hole_rows(records, calibrations, names)
    holes = {
        f"rep028/hole-{number}": f"R {radius:g} mm" for number, radius in enumerate(RADII_MM, 1)
    }
    report = Report(
        title="Holes by touch",
        settings=settings,
        about={
            "radii_mm": list(RADII_MM),
            "repeatability_mm": SIGMAS_MM,
            "calibration_touches_per_direction": QUICK_CYCLES if options.quick else CYCLES,
        },
        rows=rows,
        first=FIRST,
        findings=lines_of(rows, FIRST, names),
        figures=[
            (
                f"{metric} of each hole (simulated, repeatability 0.028 mm)",
                dot_figure(rows, holes, names, metric),
            )
            for metric in ("position_rmse_mm", "radius_rmse_mm")
        ],
        methods={name: METHODS[name].about for name in names},
    )
    return write_report(report, options, trials=len(records))


def touch_all(options: RunOptions, seeds: range) -> tuple[dict[int, Record], list[Record]]:
    """Make every touch of a run, or read it from disk.

    Returns:
        Calibrations by seed; searches of every seed and hole.
    """
    plates = [HoleJob(options.output, seed, quick=options.quick) for seed in seeds]
    holes = [replace(plate, hole=hole) for plate in plates for hole in range(len(RADII_MM))]
    progress = Progress(options, len(plates) + len(holes))
    with options.pool(len(holes)) as pool:
        calibrated = progress.run(pool, run_calibration, plates)
        searched = progress.run(pool, run_searches, holes)
    return {record["seed"]: record for record in calibrated}, searched
