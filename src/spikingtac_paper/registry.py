"""The experiments and the benches by name; each module is imported when it is run."""

import importlib
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

from spikingtac.cli import progress, tell
from spikingtac.errors import named
from spikingtac_paper.harness.run import RunOptions

# Name -> module with ``run(options) -> summary``, and what it measures, for the help.
Studies = dict[str, tuple[str, str]]
EXPERIMENTS: Studies = {
    "point-tracking": ("spikingtac_paper.point_tracking.experiment", "section V-A"),
    "denoise": ("spikingtac_paper.denoise", "section IV-B"),
    "collision": ("spikingtac_paper.collision.experiment", "section V-B"),
    "holes": ("spikingtac_paper.holes.experiment", "section V-C"),
    "touch": ("spikingtac_paper.touch.experiment", "touches, slip and forces"),
    "real": ("spikingtac_paper.real_gels", "recorded gels"),
}
BENCHES: Studies = {
    "throughput": ("spikingtac_paper.throughput.bench", "rates and latencies of this machine"),
    "live": ("spikingtac_paper.live.bench", "the live runtime under faults and loads"),
}


def choices_text(studies: Studies) -> str:
    """Return the names and what they measure as one line of help."""
    return "; ".join(f"{name} ({about})" for name, (_, about) in studies.items()) + "."


def run_study(studies: Studies, kind: str, args: Any) -> int:
    """Run an experiment or a bench with the arguments of its verb, and print its findings.

    Args:
        studies: :data:`EXPERIMENTS` or :data:`BENCHES`.
        kind: What they are, for the error.
        args: Arguments of the verb; those with the name of a run option are passed on.

    Raises:
        ConfigError: There is none of that name.
    """
    study = importlib.import_module(named(studies, args.name, kind)[0])
    known = {field.name for field in fields(RunOptions)}
    given = {name: value for name, value in vars(args).items() if name in known}
    with progress(args.name) as advance:
        options = RunOptions(**given, data=recordings_from_elsewhere(), advance=advance)
        summary = study.run(options)
    return tell(args.json, summary, *summary["findings"], f"report: {args.output / 'report.html'}")


def recordings_from_elsewhere() -> Path | None:
    """Return the folder in the variable ``SPIKINGTAC_DATA``, or None."""
    folder = os.environ.get("SPIKINGTAC_DATA")
    return Path(folder).absolute() if folder and Path(folder).is_dir() else None
