"""Section V-A: point tracking on ten contact trajectories, with baselines and ground truth."""

from collections.abc import Iterator, Sequence
from typing import Any

from spikingtac.sim import TRAJECTORIES
from spikingtac_paper.harness.report import Report, Row, dot_figure, lines_of, rows_of, write_report
from spikingtac_paper.harness.run import RunOptions, select_methods
from spikingtac_paper.point_tracking.ablation import (
    ABLATION_SCENES,
    ablation_methods,
    ablation_trials,
    methods_on,
)
from spikingtac_paper.point_tracking.cases import (
    ALL,
    CAMERAS,
    DAMAGES,
    FIFTY,
    LOOPS,
    V2E_TRIAL,
    VARIANTS,
    main_trials,
)
from spikingtac_paper.trials.methods import TRUTH, all_methods
from spikingtac_paper.trials.metrics import POINT_METRICS
from spikingtac_paper.trials.runner import TrialJob, run_all
from spikingtac_paper.trials.trial import V2E, RecordedTrial, Trial

NAME = "point-tracking"
FULL_SEEDS = 5  # Seeds of a full run.

# Cases whose tables the page shows first.
FIRST = (*(prefix + ALL for prefix in CAMERAS), f"{V2E}/mix", LOOPS, FIFTY,
         *(f"broken-{count}" for count in DAMAGES))  # fmt: skip

# (method, metric) of the case ``all`` -> number in the paper's table 'Performance Comparison of
# Point Tracking Algorithms', measured on its authors' hardware.
PUBLISHED: dict[tuple[str, str], float] = {
    ("paper", "success_rate"): 1.0,
    ("paper", "return_mean_px"): 0.8039,
    ("paper", "return_std_px"): 0.4097,
    ("evetac", "success_rate"): 0.8,
    ("evetac", "return_mean_px"): 1.6276,
    ("evetac", "return_std_px"): 0.8525,
    ("neutac", "success_rate"): 1.0,
    ("neutac", "return_mean_px"): 1.4212,
    ("neutac", "return_std_px"): 0.5742,
}

# Methods of the figures.
DRAWN = ("default", "fast", "paper", "evetac", "neutac", "ekalibr", TRUTH)


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    table = ablation_methods if options.ablations else all_methods
    known = table()
    names = select_methods((*known, TRUTH), options.methods)
    count = options.seeds or (1 if options.quick or options.ablations else FULL_SEEDS)
    settings = options.begin(
        experiment=NAME, ablations=options.ablations, first_seed=options.seed, seeds=count
    )
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
    records = run_all(jobs, options)
    rows = rows_of(records, POINT_METRICS, PUBLISHED, paper_case=ALL)
    report = Report(
        title="Point tracking" + (": ablations" if options.ablations else ""),
        settings=settings | {"methods": names},
        about={
            "scenes": {record["trial"]["case"]: record["key"] for record in records},
            "foreign_recordings": V2E_TRIAL.is_there(options.data),
        },
        rows=rows,
        first=FIRST,
        findings=lines_of(rows, FIRST, ("default",)),
        figures=() if options.ablations else _figures(rows, names),
        methods={name: known[name].about for name in names if name in known}
        | {TRUTH: "the true positions: their return distance is the residual of the gel"},
    )
    return write_report(report, options, trials=len(jobs))


def _figures(rows: Sequence[Row], names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the figures of the ten sequences, each with its caption."""
    labels = {scene: f"{number}\n{scene}" for number, scene in enumerate(TRAJECTORIES, 1)}
    drawn = [one for one in DRAWN if one in names]
    caption = "{} of each of the ten sequences (simulated)"
    return [
        (caption.format(metric), dot_figure(rows, labels, drawn, metric))
        for metric in ("return_mean_px", "error_mean_px")
    ]


def _trials(
    options: RunOptions, seeds: range
) -> Iterator[tuple[Trial | RecordedTrial, tuple[str, ...]]]:
    """Yield the trials, each with the names of its methods."""
    if options.ablations:
        scenes = ABLATION_SCENES[:1] if options.quick else ABLATION_SCENES
        for trial in ablation_trials(seeds, scenes):
            yield trial, (*methods_on(trial), TRUTH)
        return
    every = (*all_methods(), TRUTH)
    plain = tuple(name for name in every if name not in VARIANTS)
    if V2E_TRIAL.is_there(options.data):
        yield V2E_TRIAL, plain if options.quick else every
    for trial in main_trials(seeds, options.quick):
        yield trial, every if trial.camera == "typical" and not options.quick else plain
