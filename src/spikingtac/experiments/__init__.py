"""The paper's experiments, re-run: methods x trials -> predictions -> scores -> report."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikingtac.errors import ConfigError, nearest

EXPERIMENTS: dict[str, str] = {
    "point-tracking": "spikingtac.experiments.point_tracking.experiment",
    "denoise": "spikingtac.experiments.denoise.experiment",
    "collision": "spikingtac.experiments.collision.experiment",
    "holes": "spikingtac.experiments.holes.experiment",
    "real": "spikingtac.experiments.real_gels.experiment",
}
"""Name -> module with ``run(options) -> summary``, imported when it is asked for."""

BENCHES: dict[str, str] = {
    "throughput": "spikingtac.experiments.throughput.bench",
}
"""The same for ``spikingtac bench``."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RunOptions:
    """What every experiment and bench can be told.

    Attributes:
        output: Folder to write; empty, new, or with ``resume`` one of the same settings.
        quick: Fewer seeds, in some minutes.
        seed: First seed.
        seeds: How many; None is the experiment's own number.
        resume: Go on with a run that was interrupted.
        workers: Processes; None is one for each CPU.
        methods: Only these; empty is all.
        ablations: Run the ablations instead of the main tables, where there are any.
        data: Folder of foreign recordings, or None.
        advance: Is told the share that is done, 0 to 1.
    """

    output: Path
    quick: bool = False
    seed: int = 0
    seeds: int | None = None
    resume: bool = False
    workers: int | None = None
    methods: tuple[str, ...] = ()
    ablations: bool = False
    data: Path | None = None
    advance: Callable[[float], None] | None = None

    def command(self, name: str) -> str:
        """Return the command line that runs an experiment so."""
        words = ["spikingtac experiment", name, f"-o {self.output.name}"]
        words += ["--quick"] if self.quick else []
        words += ["--ablations"] if self.ablations else []
        words += [f"--seed {self.seed}"] if self.seed else []
        words += [f"--seeds {self.seeds}"] if self.seeds else []
        words += [f"--methods {' '.join(self.methods)}"] if self.methods else []
        return " ".join(words)


def runner_of(table: dict[str, str], name: str, kind: str) -> Callable[[RunOptions], Any]:
    """Return the function that runs an experiment or a bench.

    Raises:
        ConfigError: There is none of that name.
    """
    if name not in table:
        raise ConfigError(f"unknown {kind} {name!r}{nearest(name, table)} "
                          f"(valid: {', '.join(table)})")  # fmt: skip
    return importlib.import_module(table[name]).run


def chosen(known: Collection[str], wanted: Collection[str]) -> list[str]:
    """Return the wanted methods in the known order; all where none is named.

    Raises:
        ConfigError: One is unknown.
    """
    for name in wanted:
        if name not in known:
            raise ConfigError(
                f"unknown method {name!r}{nearest(name, known)} (valid: {', '.join(known)})"
            )
    return [name for name in known if not wanted or name in wanted]
