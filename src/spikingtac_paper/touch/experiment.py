"""What is felt, beside simpler methods and what others print: forces, wrenches, touches."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from spikingtac_paper.harness.report import Report, lines_of, rows_of, write_report
from spikingtac_paper.harness.run import Record, RunOptions, select_methods
from spikingtac_paper.touch import forces, patches, slip, touches

NAME = "touch"


@dataclass(frozen=True, slots=True)
class Part:
    """A simulated part of the experiment, repeated for each seed.

    Attributes:
        methods: Name -> one line about it.
        records: From names of methods, seed and whether the run is quick to records.
        full_seeds: Seeds of a full run, unless their number is given. Three of each part would make
            it three times as long.
    """

    methods: Mapping[str, str]
    records: Callable[[list[str], int, bool], list[Record]]
    full_seeds: int = 1

    def seeds(self, options: RunOptions) -> range:
        """Return the seeds of a run."""
        own = 1 if options.quick else self.full_seeds
        return range(options.seed, options.seed + (options.seeds or own))


PARTS = {
    "wrench": Part(forces.TWIN_METHODS, forces.wrench_records),
    "touches": Part(touches.METHODS, touches.touch_records, full_seeds=3),
    "patch": Part(patches.METHODS, patches.patch_records),
    "slip": Part(slip.METHODS, slip.slip_records),
}
METHODS: dict[str, str] = {**forces.RECORDED_METHODS}
for _part in PARTS.values():
    METHODS |= _part.methods
METRICS = (*forces.METRICS, *touches.METRICS, *patches.METRICS, *slip.METRICS)

# Cases on the first page.
FIRST = ("force/pooled", "wrench/all", "wrench-typical/all", "wrench-noisy/all", "touches/all",
         "patch/all", "slip/all", "held/all")  # fmt: skip


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary.

    Raises:
        ConfigError: A method is unknown, a seed is none of this experiment's, or the folder holds
            other results.
    """
    names = select_methods(METHODS, options.methods)
    if slip.METHODS.keys() & names:
        slip.require_seeds(PARTS["slip"].seeds(options))
    seeds, touch_seeds = (len(PARTS[name].seeds(options)) for name in ("slip", "touches"))
    settings = options.begin(
        experiment=NAME,
        first_seed=options.seed,
        seeds=seeds,
        touch_seeds=touch_seeds,
        methods=names,
    )
    records = _records(options, names)
    rows = rows_of(records, METRICS)
    report = Report(
        title="What is felt",
        settings=settings,
        rows=rows,
        first=FIRST,
        findings=lines_of(rows, FIRST, names),
        methods={name: METHODS[name] for name in names},
    )
    return write_report(report, options, trials=len(records))


def _records(options: RunOptions, names: list[str]) -> list[Record]:
    records = []
    if options.data is not None:
        chosen = [name for name in forces.RECORDED_METHODS if name in names]
        records += forces.force_records(options.data, chosen)
    for done, part in enumerate(PARTS.values(), 1):
        options.report_progress(done, len(PARTS) + 1)
        chosen = [name for name in part.methods if name in names]
        for seed in part.seeds(options) if chosen else ():
            records += part.records(chosen, seed, options.quick)
    options.report_progress(1, 1)
    return records
