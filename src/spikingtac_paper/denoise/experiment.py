"""The ``denoise`` experiment: the error of marker centroids behind each denoiser.

The methods are none, median3, box7, the shipped network in float32 and int8, and a network that was
trained with the simulator's noise-free maps (``supervised``, an upper bound); each with and without
the event-activity filter. The twin's recordings are rendered without noise and degraded afterwards,
so the reference is exact.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spikingtac.batch.run_folder import begin_run
from spikingtac.schema import to_mapping
from spikingtac_paper.denoise.cases import (
    METHODS,
    UNITS,
    DenoiseConfig,
    Samples,
    report_rows,
    score_all,
)
from spikingtac_paper.denoise.figures import before_and_after
from spikingtac_paper.denoise.recordings import open_v2e, render
from spikingtac_paper.denoise.scoring import ACTIVITY
from spikingtac_paper.harness.fingerprint import provenance
from spikingtac_paper.harness.report import Report, Table, find_row
from spikingtac_paper.harness.report_files import write_report
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.run_options import RunOptions
from spikingtac_paper.trials.trials import V2E

NAME = "denoise"
FIRST_SEED = 1001
"""Is added to the run's seed, since training uses seeds 1 and 2."""
FULL_SEEDS = 2
"""Seeds of a full run."""
QUICK = {"duration_s": 5.0, "every_us": 500_000}
"""Settings of a quick run: fewer moments, but nearly full length, since noise accumulates in a
binary map."""
GROUPS = {
    "": "Ten trajectories",
    "heldout/": "Held-out motion (torsion)",
    f"{V2E}/": "The v2e recording mix",
    "fast/": "Fast markers",
    "slow/": "Slow markers",
}
"""Prefix of a case -> title, in the order of the tables."""
FINDING_CASES = (("binary", 1.0, 0.5), ("binary", 0.05, 0.1), ("graded", 1.0, 0.5))
"""Map, background (Hz/px) and fraction of dropped events of the cases on the first page."""
ABOUT = {
    "none": "the map as it is",
    "median3": "3x3 median",
    "box7": "7x7 mean",
    "network": "the shipped unsupervised network, float32",
    "network-int8": "the same in int8",
    "supervised": "SUPERVISED with the simulator's noise-free maps: an upper bound, not a method",
}


@dataclass(frozen=True, slots=True)
class RecordingJob:
    """One recording for one process: a scene, or the v2e recording of a folder."""

    config: DenoiseConfig
    scene: str
    seed: int
    data: Path | None = None


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    count = options.seeds or (1 if options.quick else FULL_SEEDS)
    seeds = tuple(FIRST_SEED + options.seed + number for number in range(count))
    config = replace(DenoiseConfig(seeds=seeds), **(QUICK if options.quick else {}))
    settings = {"experiment": NAME, "quick": options.quick, **to_mapping(config)}
    begin_run(options.output, settings, options.resume, options.overwrite)
    parts = list(_in_processes(_jobs(config, options.data), options))
    rows = report_rows(parts)
    report = Report(
        experiment=NAME,
        title="Denoising",
        provenance=provenance(options.command(NAME), settings),
        rows=rows,
        findings=findings(rows),
        tables=_tables(rows),
        figures=[before_and_after(config)],
        methods=ABOUT | {f"{ACTIVITY}...": "the same behind the event-activity filter"},
    )
    return write_report(report, options.output)


def score_job(job: RecordingJob) -> Samples:
    """Make one recording and score every method in every case on it."""
    if job.data is not None:
        return score_all(open_v2e(job.data / V2E), job.config, job.seed)
    return score_all(render(job.scene, job.seed, job.config.duration_s), job.config, job.seed)


def findings(rows: Sequence[Row]) -> list[str]:
    """Return the findings: sentences that are computed from the rows alone."""
    sentences = (
        _compared(rows, prefix, kind, noise_hz, drop)
        for prefix in ("", "heldout/", f"{V2E}/")
        for kind, noise_hz, drop in FINDING_CASES
    )
    return [sentence for sentence in sentences if sentence]


def _compared(
    rows: Sequence[Row], prefix: str, kind: str, noise_hz: float, drop: float
) -> str | None:
    case = f"{prefix}{kind}@{noise_hz}-{drop}"

    def excess(method: str) -> float | None:
        row = find_row(rows, ACTIVITY + method, case, "excess_mean_px")
        return row.value if row else None

    classical = {name: value for name in METHODS[:3] if (value := excess(name)) is not None}
    network, int8 = excess("network"), excess("network-int8")
    recall = find_row(rows, f"{ACTIVITY}network-int8", case, "recall")
    if not classical or network is None or int8 is None or recall is None or recall.value is None:
        return None
    best = min(classical, key=lambda name: classical[name])
    change = network / classical[best] - 1.0
    return (
        f"{GROUPS[prefix]}, {kind} map, {noise_hz:g} Hz/px, {drop:.0%} dropped, the same event "
        f"filter before every method: excess of the network {network:.3f} px (int8 {int8:.3f} px, "
        f"recall {recall.value:.4f}), of the best classical filter, {best}, "
        f"{classical[best]:.3f} px: {abs(change):.0%} {'less' if change < 0 else 'more'} "
        "(simulated)."
    )


def _jobs(config: DenoiseConfig, data: Path | None) -> list[RecordingJob]:
    jobs = [RecordingJob(config, scene, seed) for scene in config.scenes for seed in config.seeds]
    if data is not None and (data / V2E / "mix.raw").is_file():
        jobs.insert(0, RecordingJob(config, "mix", config.seeds[0], data))
    return jobs


def _in_processes(jobs: Sequence[RecordingJob], options: RunOptions) -> Iterator[Samples]:
    with options.pool(len(jobs)) as pool:
        futures = [pool.submit(score_job, job) for job in jobs]
        for number, future in enumerate(as_completed(futures), 1):
            future.result()
            options.report_progress(number, len(jobs))
        yield from (future.result() for future in futures)


def _tables(rows: Sequence[Row]) -> list[Table]:
    methods = [prefix + name for prefix in ("", ACTIVITY) for name in METHODS]
    cases = sorted(dict.fromkeys(row.case for row in rows), key=_place)
    return [Table.of_case(case, UNITS, methods) for case in cases]


def _place(case: str) -> int:
    before, slash, _ = case.rpartition("/")
    return list(GROUPS).index(before + slash)
