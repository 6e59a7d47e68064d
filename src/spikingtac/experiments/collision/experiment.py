"""Section V-B: stop the arm at contact, beside frame-based baselines (simulated).

The false stops are counted on a fast path for motion without contact; everything else runs through
the whole twin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict
from typing import Any

from spikingtac.experiments import RunOptions
from spikingtac.experiments.collision.figures import figures
from spikingtac.experiments.collision.findings import findings
from spikingtac.experiments.collision.methods import chosen_methods, collision_methods
from spikingtac.experiments.collision.plan import (
    ALL,
    FASTEST,
    PRESETS,
    SERIES_MM,
    SLOW,
    Approached,
    CollisionConfig,
    Plan,
    Stretch,
    plan,
    series,
)
from spikingtac.experiments.collision.scene import CollisionScene
from spikingtac.experiments.collision.scoring import DEFINITIONS, collision_rows
from spikingtac.experiments.collision.work import QUIET_STEPS, Work, run_work
from spikingtac.experiments.harness.fingerprint import provenance
from spikingtac.experiments.harness.report import Report, Table
from spikingtac.experiments.harness.rows import Row
from spikingtac.experiments.harness.run_folder import claim
from spikingtac.experiments.harness.worker_pool import worker_pool

NAME = "collision"
Record = dict[str, Any]
Run = Callable[[Sequence[Work]], list[Record]]


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    names = chosen_methods(options.methods)
    config = sized(options)
    settings = {
        "experiment": NAME,
        "quick": options.quick,
        "methods": names,
        **asdict(config),
    }
    claim(options.output, settings, options.resume)
    approaches, stretches = run_all(options, config, names)
    report = make_report(approaches, stretches, provenance(options.command(NAME), settings))
    report.write(options.output)
    return {
        "experiment": NAME,
        "output": str(options.output),
        "approaches": len(approaches),
        "rows": len(report.rows),
        "findings": list(report.findings),
    }


def make_report(
    approaches: Sequence[Record], stretches: Sequence[Record], made_by: dict[str, Any]
) -> Report:
    """Return the report of what was done.

    Args:
        approaches: Their records.
        stretches: The same of the contact-free stretches.
        made_by: Command, settings, versions, machine.
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


def sized(options: RunOptions) -> CollisionConfig:
    """Return how large a run is; ``seeds`` scales the approaches at each speed."""
    if options.quick:
        return CollisionConfig.quick(options.seed)
    full = CollisionConfig(first_seed=options.seed)
    if options.seeds is None:
        return full
    return CollisionConfig(first_seed=options.seed, seeds=options.seeds)


def run_all(
    options: RunOptions, config: CollisionConfig, names: Sequence[str]
) -> tuple[list[Record], list[Record]]:
    """Make, or read from disk, every approach and stretch of a run."""
    main, later = plan(config), series(config)
    done, total = (
        0,
        len(main.scenes)
        + sum(len(part) for one in (main, later) for part in (one.approaches, one.stretches)),
    )
    with worker_pool(options.workers, total) as pool:

        def go(works: Sequence[Work]) -> list[Record]:
            nonlocal done
            futures = [pool.submit(run_work, work) for work in works]
            for future in as_completed(futures):
                future.result()
                done += 1
                if options.advance:
                    options.advance(done / total)
            return [future.result() for future in futures]

        return _everything(options, names, (main, later), go)


def _everything(
    options: RunOptions, names: Sequence[str], plans: tuple[Plan, Plan], go: Run
) -> tuple[list[Record], list[Record]]:
    main, later = plans

    def work(task: CollisionScene | Approached | Stretch, enough: tuple[str, ...] = ()) -> Work:
        events = isinstance(task, Approached) and task.group in ("sensitivity", "curve")
        known = collision_methods()
        asked = tuple(name for name in names if not events or known[name].sees == "events")
        if enough:
            asked = tuple(n for n in asked if n in enough or known[n].sees != "events")
        return Work(folder=options.output, task=task, methods=asked, enough=enough)

    go([work(scene) for scene in main.scenes])
    tasks = [*main.stretches, *main.approaches]
    records = go([work(task) for task in tasks])
    stretches = [one for one, task in zip(records, tasks, strict=True) if isinstance(task, Stretch)]
    approaches = [
        one for one, task in zip(records, tasks, strict=True) if isinstance(task, Approached)
    ]
    prompt = prompt_detectors(approaches)
    if prompt and later.approaches:
        approaches += go([work(task, prompt) for task in later.approaches])
    return approaches, stretches


def prompt_detectors(approaches: Sequence[Record]) -> tuple[str, ...]:
    """Return the detectors that found every slow approach within half the series' patience.

    The others would keep the series waiting without a chance: they have the slow approaches alone.
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
