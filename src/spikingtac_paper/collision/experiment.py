"""Section V-B: stop the arm at contact, beside frame-based baselines (simulated).

A fast path for motion without contact counts the false stops; everything else uses the whole twin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict
from typing import Any

from spikingtac.batch.run_folder import begin_run
from spikingtac_paper.collision.figures import figures
from spikingtac_paper.collision.findings import findings
from spikingtac_paper.collision.jobs import QUIET_STEPS, CollisionJob, run_job
from spikingtac_paper.collision.methods import collision_methods
from spikingtac_paper.collision.plan import (
    ALL,
    FASTEST,
    PRESETS,
    SERIES_MM,
    SLOW,
    ApproachTask,
    CollisionConfig,
    FreeMotionTask,
    Plan,
    plan,
    series,
)
from spikingtac_paper.collision.scene import CollisionScene
from spikingtac_paper.collision.scoring import DEFINITIONS, collision_rows
from spikingtac_paper.harness.fingerprint import provenance
from spikingtac_paper.harness.records import Record
from spikingtac_paper.harness.report import Report, Table
from spikingtac_paper.harness.report_files import write_report
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.run_options import RunOptions, select_methods

NAME = "collision"
RunJobs = Callable[[Sequence[CollisionJob]], list[Record]]


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    names = select_methods(collision_methods(), options.methods)
    config = run_size(options)
    settings = {
        "experiment": NAME,
        "quick": options.quick,
        "methods": names,
        **asdict(config),
    }
    begin_run(options.output, settings, options.resume, options.overwrite)
    approaches, stretches = run_all(options, config, names)
    report = make_report(approaches, stretches, provenance(options.command(NAME), settings))
    return write_report(report, options.output, approaches=len(approaches))


def make_report(
    approaches: Sequence[Record], stretches: Sequence[Record], made_by: dict[str, Any]
) -> Report:
    """Return the report of a run.

    Args:
        approaches: Records of the approaches.
        stretches: Records of the motions without contact.
        made_by: Command, settings, versions and machine, from ``fingerprint.provenance``.
    """
    rows = collision_rows(approaches, stretches)
    known = collision_methods()
    names = [name for name in known if any(row.method == name for row in rows)]
    return Report(
        experiment=NAME,
        title="Collision",
        provenance=made_by | _pinned(),
        rows=rows,
        findings=findings(rows),
        tables=_tables(rows, names),
        figures=figures(rows, approaches),
        methods={name: known[name].about for name in names},
    )


def run_size(options: RunOptions) -> CollisionConfig:
    """Return the size of a run; ``seeds`` sets the number of approaches at each speed."""
    if options.quick:
        return CollisionConfig.quick(options.seed)
    full = CollisionConfig(first_seed=options.seed)
    if options.seeds is None:
        return full
    return CollisionConfig(first_seed=options.seed, seeds=options.seeds)


def run_all(
    options: RunOptions, config: CollisionConfig, names: Sequence[str]
) -> tuple[list[Record], list[Record]]:
    """Simulate every task of a run, or read its record from disk."""
    main, later = plan(config), series(config)
    done, total = (
        0,
        len(main.scenes)
        + sum(len(part) for one in (main, later) for part in (one.approaches, one.stretches)),
    )
    with options.pool(total) as pool:

        def run_jobs(jobs: Sequence[CollisionJob]) -> list[Record]:
            nonlocal done
            futures = [pool.submit(run_job, job) for job in jobs]
            for future in as_completed(futures):
                future.result()
                done += 1
                options.report_progress(done, total)
            return [future.result() for future in futures]

        return _everything(options, names, (main, later), run_jobs)


def _everything(
    options: RunOptions, names: Sequence[str], plans: tuple[Plan, Plan], run_jobs: RunJobs
) -> tuple[list[Record], list[Record]]:
    main, later = plans

    def job(
        task: CollisionScene | ApproachTask | FreeMotionTask, required: tuple[str, ...] = ()
    ) -> CollisionJob:
        events = isinstance(task, ApproachTask) and task.group in ("sensitivity", "curve")
        known = collision_methods()
        selected = tuple(name for name in names if not events or known[name].sees == "events")
        if required:
            selected = tuple(n for n in selected if n in required or known[n].sees != "events")
        return CollisionJob(folder=options.output, task=task, methods=selected, required=required)

    run_jobs([job(scene) for scene in main.scenes])
    tasks = [*main.stretches, *main.approaches]
    records = run_jobs([job(task) for task in tasks])
    stretches = [
        one for one, task in zip(records, tasks, strict=True) if isinstance(task, FreeMotionTask)
    ]
    approaches = [
        one for one, task in zip(records, tasks, strict=True) if isinstance(task, ApproachTask)
    ]
    fast = fast_detectors(approaches)
    if fast and later.approaches:
        approaches += run_jobs([job(task, fast) for task in later.approaches])
    return approaches, stretches


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


def _pinned() -> dict[str, Any]:
    scenes = {preset: CollisionScene(preset=preset) for preset in PRESETS}
    return {
        "scenes": {preset: scene.resolved() for preset, scene in scenes.items()},
        "scene_digests": {preset: scene.digest() for preset, scene in scenes.items()},
        "quiet_s": QUIET_STEPS * 1e-3,
        "sensors": 1,
    }


def _tables(rows: Sequence[Row], names: Sequence[str]) -> list[Table]:
    prefixed = [case for case in dict.fromkeys(row.case for row in rows) if "/" in case]
    first = [f"{preset}/{case}" for preset in PRESETS for case in (ALL, FASTEST, SLOW)]
    shown = [case for case in first if case in prefixed]
    rest = [case for case in prefixed if case not in shown and not case.startswith("budget")]
    return [
        Table.of_case(case, DEFINITIONS, names, folded=case not in shown)
        for case in (*shown, *rest)
    ]
