"""What is felt, beside simpler methods and what others print: forces, wrenches, touches."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any

from spikingtac.batch import begin_run
from spikingtac_paper.harness.report import Metric, Report, lines_of, rows_of, write_report
from spikingtac_paper.harness.run import RunOptions, provenance, select_methods
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
FIRST = ("force/pooled", "wrench/all", "wrench-typical/all", "wrench-noisy/all", "touches/all",
         "patch/all", "slip/all", "held/all")  # fmt: skip
"""Cases on the first page."""


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
    rows = rows_of(records, METRICS)
    report = Report(
        experiment=NAME,
        title="What is felt",
        provenance=provenance(options.command("experiment", NAME), settings),
        rows=rows,
        first=FIRST,
        findings=lines_of(rows, FIRST, names),
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
