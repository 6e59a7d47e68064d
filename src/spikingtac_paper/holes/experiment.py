"""Section V-C: centre and radius of ten holes by touch, beside the paper's table (simulated)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from spikingtac.batch.run_folder import begin_run
from spikingtac.sim.rig.wall_calibration import SIGMAS_MM
from spikingtac_paper.harness.fingerprint import provenance
from spikingtac_paper.harness.records import Record
from spikingtac_paper.harness.report import Report, Table, find_row
from spikingtac_paper.harness.report_files import write_report
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.run_options import RunOptions, select_methods
from spikingtac_paper.holes.figures import error_figure, plate_figure
from spikingtac_paper.holes.jobs import (
    CYCLES,
    DETECTOR,
    QUICK_CYCLES,
    RADII_MM,
    HoleJob,
    run_calibration,
    run_searches,
)
from spikingtac_paper.holes.scoring import DEFINITIONS, METHODS, hole_rows

NAME = "holes"
FULL_SEEDS = 20
"""Seeds of a full run."""
TARGETS_MM = {
    ("rep028", "default-4"): (0.06, 0.04),
    ("rep028", "default-12"): (0.03, 0.02),
    ("rep008", "default-4"): (0.04, 0.03),
    ("rep008", "default-12"): (0.02, 0.015),
}
"""(prefix, method) -> aims of position RMSE and radius RMSE, mm."""


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
    begin_run(options.output, settings, options.resume, options.overwrite)
    calibrations, records = touch_all(options, range(options.seed, options.seed + count))
    rows = hole_rows(records, calibrations, names)
    report = Report(
        experiment=NAME,
        title="Holes by touch",
        provenance=provenance(options.command(NAME), settings) | _assumptions(options.quick),
        rows=rows,
        findings=findings(rows),
        tables=_tables(rows, names),
        figures=_figures(rows, records, calibrations, names),
        methods={name: METHODS[name].about for name in names},
    )
    return write_report(report, options.output, trials=len(records))


def touch_all(options: RunOptions, seeds: range) -> tuple[dict[int, Record], list[Record]]:
    """Make every touch of a run, or read it from disk.

    Returns:
        Calibrations by seed; searches of every seed and hole.
    """
    plates = [HoleJob(options.output, seed, quick=options.quick) for seed in seeds]
    holes = [replace(plate, hole=hole) for plate in plates for hole in range(len(RADII_MM))]
    searched: list[Record] = []
    with options.pool(len(holes)) as pool:
        calibrated = list(pool.map(run_calibration, plates))
        for record in pool.map(run_searches, holes):
            searched.append(record)
            options.report_progress(len(searched), len(holes))
    return {record["seed"]: record for record in calibrated}, searched


def findings(rows: Sequence[Row]) -> list[str]:
    """Return the findings: sentences that are computed from the rows alone."""
    return [*_paper_findings(rows), *_target_findings(rows), *_honesty_findings(rows)]


def _paper_findings(rows: Sequence[Row]) -> list[str]:
    sentences = []
    for method in ("cross4-published", "cross4"):
        value = {name: _value(rows, method, "rep028/all", name) for name in DEFINITIONS}
        if value["position_rmse_mm"] is not None:
            sentences.append(
                f"{method}: position RMSE {value['position_rmse_mm']:.4f} mm "
                f"({value['position_rmse_kabsch_mm']:.4f} after Kabsch; paper 0.0952), radius RMSE "
                f"{value['radius_rmse_mm']:.4f} mm (paper 0.0780), signed mean "
                f"{value['radius_mean_signed_mm']:+.4f} mm (paper 0.0452, there called RMSE); "
                "simulated, repeatability 0.028 mm."
            )
    return sentences


def _target_findings(rows: Sequence[Row]) -> list[str]:
    sentences = []
    for (prefix, method), (position, radius) in TARGETS_MM.items():
        found = _value(rows, method, f"{prefix}/all", "position_rmse_mm")
        size = _value(rows, method, f"{prefix}/all", "radius_rmse_mm")
        if found is not None and size is not None:
            verdict = "met" if found <= position and size <= radius else "missed"
            sentences.append(
                f"{prefix}, {method}: position RMSE {found:.4f} mm, radius RMSE {size:.4f} mm; "
                f"aim {position} / {radius}: {verdict} (simulated)."
            )
    return sentences


def _honesty_findings(rows: Sequence[Row]) -> list[str]:
    sentences = []
    for method in ("default-4", "default-12"):
        values = {
            name: [_value(rows, method, f"{prefix}/all", name) for prefix in SIGMAS_MM]
            for name in ("coverage95", "bound_ratio", "diverged", "touches")
        }
        if None not in values["bound_ratio"]:
            cover, ratio, lost, touches = (
                " / ".join(f"{value:.3g}" for value in values[name] if value is not None)
                for name in values
            )
            sentences.append(
                f"{method} ({' / '.join(SIGMAS_MM)}): 95 % regions cover {cover} of the trials, "
                f"position RMSE over its bound {ratio}, diverged {lost}, wall touches per hole, "
                f"finding and conditioning included, {touches}."
            )
    return sentences


def _value(rows: Sequence[Row], method: str, case: str, metric: str) -> float | None:
    row = find_row(rows, method, case, metric)
    return row.value if row else None


def _assumptions(quick: bool) -> dict[str, Any]:
    return {
        "radii_mm": list(RADII_MM),
        "repeatability_mm": SIGMAS_MM,
        "calibration_touches_per_direction": QUICK_CYCLES if quick else CYCLES,
        "detector": DETECTOR,
    }


def _tables(rows: Sequence[Row], names: Sequence[str]) -> list[Table]:
    cases = list(dict.fromkeys(row.case for row in rows))
    return [
        Table.of_case(case, DEFINITIONS, names, folded=not case.endswith("/all")) for case in cases
    ]


def _figures(
    rows: Sequence[Row],
    records: Sequence[Record],
    calibrations: Mapping[int, Record],
    names: Sequence[str],
) -> list[tuple[str, str]]:
    seed = min(record["seed"] for record in records)
    plate = [record for record in records if record["seed"] == seed]
    note = (
        "95 % region and error of the centre, and the contacts' residuals, are drawn larger by the "
        "factors above each hole"
    )
    figures = [
        (
            "Position and radius RMSE of each hole (simulated, repeatability 0.028 mm); diamonds: "
            "the paper's table, one measured trial of each hole.",
            error_figure(rows, names),
        )
    ]
    for name in names:
        svg = plate_figure(plate, calibrations[seed], name)
        figures.append((f"{name}, seed {seed} (simulated): {note}.", svg))
    return figures
