"""What is felt, beside simpler methods and what others print: forces, wrenches, touches."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any

from spikingtac.batch.run_folder import begin_run
from spikingtac_paper.harness.fingerprint import provenance
from spikingtac_paper.harness.metric import Metric
from spikingtac_paper.harness.report import Report, Table, find_row
from spikingtac_paper.harness.report_files import write_report
from spikingtac_paper.harness.rows import Row, rows_of
from spikingtac_paper.harness.run_options import RunOptions, select_methods
from spikingtac_paper.touch import (
    recorded_forces,
    twin_patches,
    twin_slip,
    twin_touches,
    twin_wrench,
)

NAME = "touch"
TOUCH_SEEDS, SEEDS = 3, 1
"""Seeds of the touches, and of the other simulated parts, unless their number is given: three each
would make a run three times as long."""
SIMULATED = {
    twin_wrench: twin_wrench.wrench_records,
    twin_touches: twin_touches.touch_records,
    twin_patches: twin_patches.patch_records,
    twin_slip: twin_slip.slip_records,
}
"""The simulated parts, each with what makes its records of one seed."""
PARTS = (recorded_forces, *SIMULATED)
METHODS: dict[str, str] = {name: about for part in PARTS for name, about in part.METHODS.items()}
METRICS: tuple[Metric, ...] = (
    *recorded_forces.METRICS,
    *twin_wrench.METRICS,
    *twin_touches.METRICS,
    *twin_patches.METRICS,
    *twin_slip.METRICS,
)
PUBLISHED = (
    "Published, their hardware: an MLP of 277 thousand parameters on a fifth series of data/force "
    "(trained on four, with depth): mean absolute errors 0.039, 0.039, 0.111 N, R2 0.988, 0.986, "
    "0.985 for Fx, Fy, Fz. That series is not among those here.",
    "Published, their hardware: Evetac (Funk and others, arXiv 2312.01236) senses vibrations up to "
    "498 Hz and reconstructs shear forces at 1,000 Hz.",
    "GelEvent and 9DTact: their printed figures were not at hand, so none stands here.",
)
"""What others print, in sentences: their sensors, loads and labels differ from those here."""


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary.

    Every simulated part is repeated for each seed; see :data:`TOUCH_SEEDS`.

    Raises:
        ConfigError: A method is unknown, a seed is none of this experiment's, or the folder holds
            other results.
    """
    names = select_methods(METHODS, options.methods)
    if _chosen(twin_slip, names):
        twin_slip.require_seeds(_seeds(options, twin_slip))
    settings = {
        "experiment": NAME,
        "quick": options.quick,
        "first_seed": options.seed,
        "seeds": len(_seeds(options, twin_slip)),
        "touch_seeds": len(_seeds(options, twin_touches)),
        "methods": names,
    }
    begin_run(options.output, settings, options.resume, options.overwrite)
    records = _records(options, names)
    rows = rows_of(records, METRICS, {}, paper_case="")
    report = Report(
        experiment=NAME,
        title="What is felt",
        provenance=provenance(options.command(NAME), settings),
        rows=rows,
        findings=[*findings(rows), *PUBLISHED],
        tables=_tables(rows, names),
        methods={name: METHODS[name] for name in names},
    )
    return write_report(report, options.output, trials=len(records))


def _chosen(part: ModuleType, names: Sequence[str]) -> list[str]:
    """Return the methods of a part that are to run."""
    return [name for name in part.METHODS if name in names]


def _seeds(options: RunOptions, part: ModuleType) -> range:
    own = TOUCH_SEEDS if part is twin_touches and not options.quick else SEEDS
    return range(options.seed, options.seed + (options.seeds or own))


def _records(options: RunOptions, names: Sequence[str]) -> list[dict[str, Any]]:
    records = []
    if options.data is not None:
        records += recorded_forces.force_records(options.data, _chosen(recorded_forces, names))
    options.report_progress(1, len(PARTS))
    for done, (part, records_of) in enumerate(SIMULATED.items(), 2):
        chosen = _chosen(part, names)
        for seed in _seeds(options, part) if chosen else ():
            records += records_of(chosen, seed, options.quick)
        options.report_progress(done, len(PARTS))
    return records


def findings(rows: Sequence[Row]) -> list[str]:
    """Return the findings: sentences that are computed from the rows alone."""
    sentences = []
    for case, part in (
        ("force/pooled", recorded_forces),
        ("wrench/all", twin_wrench),
        *((f"wrench-{camera}/all", twin_wrench) for camera in twin_wrench.CAMERAS),
        ("touches/all", twin_touches),
        ("patch/all", twin_patches),
        ("slip/all", twin_slip),
        ("held/all", twin_slip),
    ):
        for method in part.METHODS:
            found = [find_row(rows, method, case, metric.name) for metric in part.METRICS]
            figures = [
                f"{row.metric} {row.value:.3g}" for row in found if row and row.value is not None
            ]
            if figures:
                sentences.append(f"{case}, {method}: {', '.join(figures)}.")
    return sentences


def _tables(rows: Sequence[Row], names: list[str]) -> list[Table]:
    tables = []
    for case in dict.fromkeys(row.case for row in rows):
        here = [row for row in rows if row.case == case]
        metrics = dict.fromkeys(row.metric for row in here)
        methods = [name for name in names if any(row.method == name for row in here)]
        tables.append(Table.of_case(case, metrics, methods))
    return tables
