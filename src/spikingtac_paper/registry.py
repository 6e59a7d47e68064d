"""The experiments and the benches by name; each module is imported when it is run."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from spikingtac.cli import progress, tell
from spikingtac.errors import named
from spikingtac_paper.harness.run import RunOptions

Runner = Callable[[RunOptions], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Study:
    """An experiment or a bench.

    Attributes:
        module: Module with ``run(options) -> summary``.
        about: What it measures, a few words for the help.
    """

    module: str
    about: str


# Name -> experiment, for ``spikingtac experiment``.
EXPERIMENTS: dict[str, Study] = {
    "point-tracking": Study("spikingtac_paper.point_tracking.experiment", "section V-A"),
    "denoise": Study("spikingtac_paper.denoise", "section IV-B"),
    "collision": Study("spikingtac_paper.collision.experiment", "section V-B"),
    "holes": Study("spikingtac_paper.holes.experiment", "section V-C"),
    "touch": Study("spikingtac_paper.touch.experiment", "touches, slip and forces"),
    "real": Study("spikingtac_paper.real_gels", "recorded gels"),
}

# Name -> bench, for ``spikingtac bench``.
BENCHES: dict[str, Study] = {
    "throughput": Study("spikingtac_paper.throughput.bench", "rates and latencies of this machine"),
    "live": Study("spikingtac_paper.live.bench", "the live runtime under faults and loads"),
    "skins": Study(
        "spikingtac_paper.throughput.skins", "how the cost grows with markers and events"
    ),
}


def choices_text(studies: dict[str, Study]) -> str:
    """Return the names and what they measure as one line of help."""
    return "; ".join(f"{name} ({study.about})" for name, study in studies.items()) + "."


def runner_of(studies: dict[str, Study], name: str, kind: str) -> Runner:
    """Return the function that runs an experiment or a bench.

    Args:
        studies: :data:`EXPERIMENTS` or :data:`BENCHES`.
        name: Which of them.
        kind: What they are, for the error.

    Raises:
        ConfigError: There is none of that name.
    """
    return importlib.import_module(named(studies, name, kind).module).run


def run_study(study: Runner, args: Any) -> int:
    """Run an experiment or a bench with the arguments of its verb, and print its findings.

    Args:
        study: Function of the study.
        args: Arguments of the verb; those with the name of a run option are passed on.
    """
    known = {field.name for field in fields(RunOptions)}
    given = {name: value for name, value in vars(args).items() if name in known}
    with progress(args.name) as advance:
        summary = study(RunOptions(**given, data=recordings_from_elsewhere(), advance=advance))
    return tell(args.json, summary, *summary["findings"], f"report: {args.output / 'report.html'}")


def recordings_from_elsewhere() -> Path | None:
    """Return the folder in the variable ``SPIKINGTAC_DATA``, or None."""
    folder = os.environ.get("SPIKINGTAC_DATA")
    return Path(folder).absolute() if folder and Path(folder).is_dir() else None
