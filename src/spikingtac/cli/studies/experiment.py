"""``spikingtac experiment``: re-run one of the paper's experiments and write its report."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.cli.messages import emit_json, progress, remark

if TYPE_CHECKING:
    from spikingtac.experiments import RunOptions


@dataclass(frozen=True, kw_only=True)
class Args:
    """Re-run one of the paper's experiments and write report.json, report.html and tables."""

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="NAME")]
    """point-tracking (more are listed by an unknown name)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")]
    """Folder to write; new or empty, or begun with the same settings (--resume)."""
    quick: bool = False
    """One seed, shorter sequences, no fifty contacts: minutes instead of an hour."""
    ablations: bool = False
    """Variants of the default tracker instead of the main tables."""
    seed: int = 0
    """First seed."""
    seeds: int | None = None
    """How many seeds; the experiment's own number unless told."""
    methods: tuple[str, ...] = ()
    """Only these methods; all unless told."""
    resume: bool = False
    """Go on with a run that was interrupted."""
    workers: int | None = None
    """Processes; one for each CPU unless told."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Run it, and say what came out."""
    from spikingtac.experiments import EXPERIMENTS, runner_of

    return run_and_tell(runner_of(EXPERIMENTS, args.name, "experiment"), args)


def run_and_tell(function: Callable[[RunOptions], dict[str, Any]], args: Any) -> int:
    """Run an experiment or a bench with what its verb was given, and say what came out."""
    from spikingtac.experiments import RunOptions

    known = {field.name for field in fields(RunOptions)}
    given = {name: value for name, value in vars(args).items() if name in known}
    with progress(args.name) as advance:
        summary = function(RunOptions(**given, data=foreign_recordings(), advance=advance))
    if args.json:
        emit_json(summary)
        return 0
    for text in summary["findings"]:
        remark(text)
    remark(f"report: {args.output / 'report.html'}")
    return 0


def foreign_recordings() -> Path | None:
    """Return the folder that ``SPIKINGTAC_DATA`` names, or None."""
    folder = os.environ.get("SPIKINGTAC_DATA")
    return Path(folder) if folder and Path(folder).is_dir() else None
