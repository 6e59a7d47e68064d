"""The options that every experiment and bench takes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikingtac.batch.worker_pool import worker_pool
from spikingtac.errors import named

Advance = Callable[[float], None]
"""Is called with the fraction of the work that is done, 0 to 1."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RunOptions:
    """The options of a run.

    Attributes:
        output: Folder to write; empty, new, or with ``resume`` one of the same settings.
        quick: Use fewer seeds, so that the run takes some minutes.
        seed: First seed.
        seeds: Number of seeds; None takes the experiment's own number.
        resume: Continue a run that was interrupted.
        overwrite: Remove the run that is in the folder, and begin anew.
        workers: Number of processes; None takes one for each CPU.
        scheduler: Address of a Dask scheduler that takes their place, or None.
        methods: Names of the methods to run; empty runs all.
        ablations: Run the ablations instead of the main tables, where there are any.
        data: Folder of recordings from elsewhere, or None.
        advance: Is called with the fraction that is done, 0 to 1.
    """

    output: Path
    quick: bool = False
    seed: int = 0
    seeds: int | None = None
    resume: bool = False
    overwrite: bool = False
    workers: int | None = None
    scheduler: str | None = None
    methods: tuple[str, ...] = ()
    ablations: bool = False
    data: Path | None = None
    advance: Advance | None = None

    def command(self, name: str) -> str:
        """Return the command line that repeats a run of an experiment."""
        words = ["spikingtac experiment", name, f"-o {self.output.name}"]
        words += ["--quick"] if self.quick else []
        words += ["--ablations"] if self.ablations else []
        words += [f"--seed {self.seed}"] if self.seed else []
        words += [f"--seeds {self.seeds}"] if self.seeds else []
        words += [f"--methods {' '.join(self.methods)}"] if self.methods else []
        return " ".join(words)

    def pool(self, tasks: int) -> AbstractContextManager[Executor]:
        """Return the worker pool of a run, to be entered: worker processes here, or a cluster.

        Args:
            tasks: Number of tasks: more processes would be idle.
        """
        return worker_pool(self.workers, tasks, self.scheduler)

    def report_progress(self, done: int, total: int) -> None:
        """Call :attr:`advance`, if it is given, after ``done`` of ``total`` tasks."""
        if self.advance is not None:
            self.advance(done / total)


def select_methods(known: Iterable[str], given: Iterable[str]) -> list[str]:
    """Return the given methods in the order of the known ones; all of these where none is given.

    Raises:
        ConfigError: A given method is unknown.
    """
    table: Mapping[str, Any] = dict.fromkeys(known)
    selected = tuple(given)
    for name in selected:
        named(table, name, "method")
    return [name for name in table if not selected or name in selected]
