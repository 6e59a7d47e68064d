"""Run one of the paper's experiments again: every method, every case, one report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac.cli import WriteArgs
from spikingtac_paper.registry import EXPERIMENTS, choices_text, run_study


@dataclass(frozen=True, kw_only=True)
class RunArgs(WriteArgs):
    """Options of experiments and benches.

    Attributes:
        output: Folder to write: new or empty, or one that was begun with the same settings
            (--resume).
        quick: Run fewer seeds and shorter sequences: minutes instead of hours.
        seed: First seed.
        resume: Continue a run that was interrupted.
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")]
    quick: bool = False
    seed: int = 0
    resume: bool = False


@dataclass(frozen=True, kw_only=True)
class Args(RunArgs):
    """Run one of the paper's experiments again; write report.json, report.html and tables.

    Attributes:
        ablations: Run variants of the default tracker instead of the main tables (point-tracking,
            real).
        seeds: Number of seeds; the experiment's own number unless given.
        methods: Names of the methods to run; all unless given.
        workers: Number of processes; one for each CPU unless given.
    """

    name: Annotated[
        tyro.conf.Positional[str],
        tyro.conf.arg(metavar="NAME", help=f"Experiment: {choices_text(EXPERIMENTS)}"),
    ]
    ablations: bool = False
    seeds: int | None = None
    methods: tuple[str, ...] = ()
    workers: int | None = None


def run(args: Args) -> int:
    """Run the experiment and print its findings."""
    return run_study(EXPERIMENTS, "experiment", args)
