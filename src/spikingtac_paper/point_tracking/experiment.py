"""Section V-A: point tracking on ten contact trajectories, with baselines and ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from spikingtac.batch.run_folder import begin_run
from spikingtac.sim.scene.catalog import TRAJECTORIES
from spikingtac_paper.harness.fingerprint import provenance
from spikingtac_paper.harness.published import POINT_TRACKING
from spikingtac_paper.harness.report import Report
from spikingtac_paper.harness.report_files import write_report
from spikingtac_paper.harness.rows import Row, rows_of
from spikingtac_paper.harness.run_options import RunOptions, select_methods
from spikingtac_paper.point_tracking.ablation import (
    ABLATION_SCENES,
    ablation_methods,
    ablation_trials,
    methods_on,
)
from spikingtac_paper.point_tracking.cases import (
    ALL,
    VARIANTS,
    main_trials,
    v2e_trials,
)
from spikingtac_paper.point_tracking.figures import deviation_figure, key_point_figure
from spikingtac_paper.point_tracking.findings import findings
from spikingtac_paper.point_tracking.tables import report_tables
from spikingtac_paper.trials.laws import (
    LAW_MARK,
    LawMethod,
    compared_laws,
    law_rows,
    neutac_binary,
)
from spikingtac_paper.trials.methods import TRUTH, Method, main_methods
from spikingtac_paper.trials.metrics import POINT_METRICS
from spikingtac_paper.trials.runner import TrialJob, run_all
from spikingtac_paper.trials.trials import V2E, Trial

NAME = "point-tracking"
FULL_SEEDS = 5
"""Seeds of a full run."""

FIGURE_METHODS = ("default", "paper", "evetac", "neutac")
KEY_POINT_SCENE = "spoon-rubs"
"""Trajectory of the first figure, with repeated contact."""


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    table = ablation_methods if options.ablations else all_methods
    names = select_methods((*table(), TRUTH), options.methods)
    count = options.seeds or (1 if options.quick or options.ablations else FULL_SEEDS)
    settings = {
        "experiment": NAME,
        "ablations": options.ablations,
        "quick": options.quick,
        "first_seed": options.seed,
        "seeds": count,
    }
    begin_run(options.output, settings, options.resume, options.overwrite)
    jobs = [
        TrialJob(
            trial=trial,
            methods=tuple(name for name in names if name in selected),
            table=table,
            folder=options.output,
            data=options.data,
        )
        for trial, selected in _trials(options, range(options.seed, options.seed + count))
    ]
    records = run_all(jobs, options.pool, options.advance)
    report = _report(records, options, settings | {"methods": names}, table())
    return write_report(report, options.output, trials=len(jobs))


def all_methods() -> dict[str, Method | LawMethod]:
    """Return the methods of the main tables, and the output laws that use their estimates."""
    methods: dict[str, Method | LawMethod] = {}
    for name, method in main_methods().items():
        methods[name] = method
        if name == "neutac":
            methods["neutac-binary"] = neutac_binary()
    return methods | {method.name: method for method in compared_laws()}


def _trials(options: RunOptions, seeds: range) -> Iterator[tuple[Trial, tuple[str, ...]]]:
    """Yield the trials, each with the names of its methods."""
    if options.ablations:
        scenes = ABLATION_SCENES[:1] if options.quick else ABLATION_SCENES
        for trial in ablation_trials(seeds, scenes):
            yield trial, (*methods_on(trial), TRUTH)
        return
    for trial in (*v2e_trials(options.data), *main_trials(seeds, options.quick)):
        with_variants = trial.camera in ("typical", V2E) and not options.quick
        left_out = () if with_variants else VARIANTS
        yield trial, tuple(name for name in (*all_methods(), TRUTH) if name not in left_out)


def _report(
    records: list[dict[str, Any]],
    options: RunOptions,
    settings: dict[str, Any],
    table: Mapping[str, Method | LawMethod],
) -> Report:
    names = settings["methods"]
    laws = [table[name] for name in names if LAW_MARK in name]
    laws = [method for method in laws if isinstance(method, LawMethod)]
    rows = [*rows_of(records, POINT_METRICS, POINT_TRACKING, paper_case=ALL), *law_rows(laws)]
    sentences = [] if options.ablations else [*findings(rows), *_skipped(options)]
    return Report(
        experiment=NAME,
        title="Point tracking" + (": ablations" if options.ablations else ""),
        provenance=provenance(options.command(NAME), settings)
        | {"scenes": _digests(records), "foreign_recordings": options.data is not None},
        rows=rows,
        findings=sentences,
        tables=report_tables(rows, names),
        figures=[] if options.ablations else _figures(rows, records, options.output),
        methods={name: table[name].about for name in names if name in table}
        | {TRUTH: "the true positions: their return distance is the residual of the gel"},
    )


def _skipped(options: RunOptions) -> list[str]:
    if v2e_trials(options.data):
        return []
    return [
        f"{V2E}/mix was not run: the variable SPIKINGTAC_DATA names no folder with {V2E}/mix.raw."
    ]


def _digests(records: list[dict[str, Any]]) -> dict[str, str]:
    return {record["trial"]["case"]: record["key"] for record in records}


def _figures(
    rows: Sequence[Row], records: list[dict[str, Any]], folder: Path
) -> list[tuple[str, str]]:
    one = [record for record in records if record["trial"]["case"] == KEY_POINT_SCENE]
    seed = min((record["trial"]["seed"] for record in one), default=0)
    one = [record for record in one if record["trial"]["seed"] == seed]
    drawn = ("default", "fast", "paper", "evetac", "neutac", "ekalibr", TRUTH)
    figures = [
        (
            f"Stability of a single key point under repeated contact ({KEY_POINT_SCENE}, "
            "simulated): displacement of the marker that moves most, by each method.",
            key_point_figure(one, folder, FIGURE_METHODS),
        ),
        (
            "Deviation from rest at the end of each of the ten sequences (simulated; the paper's "
            "metric). The row 'truth' is the gel's own residual.",
            deviation_figure(rows, TRAJECTORIES, drawn, "return_mean_px"),
        ),
        (
            "Error against the truth over each of the ten sequences (simulated).",
            deviation_figure(rows, TRAJECTORIES, drawn[:-1], "error_mean_px"),
        ),
    ]
    return [(caption, svg) for caption, svg in figures if svg]
