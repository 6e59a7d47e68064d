"""Section V-C: centre and radius of ten holes by touch, beside the paper's table (simulated)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from spikingtac.sim import SIGMAS_MM
from spikingtac_paper.harness.report import Report, dot_figure, lines_of, write_report
from spikingtac_paper.harness.run import (
    Progress,
    Record,
    RunOptions,
    select_methods,
)
from spikingtac_paper.holes.jobs import (
    CYCLES,
    DETECTOR,
    QUICK_CYCLES,
    RADII_MM,
    HoleJob,
    run_calibration,
    run_searches,
)
from spikingtac_paper.holes.scoring import METHODS, hole_rows

NAME = "holes"
FULL_SEEDS = 20  # Seeds of a full run.
FIRST = tuple(f"{prefix}/all" for prefix in SIGMAS_MM)  # Cases whose tables the page shows first.


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    names = select_methods(METHODS, options.methods)
    count = options.seeds or (1 if options.quick else FULL_SEEDS)
    settings = {
        "experiment": NAME,
        "quick": options.quick,
        "first_seed": options.seed,
        "seeds": count,
        "methods": names,
        "detector": DETECTOR,
    }
    options.begin(settings)
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
