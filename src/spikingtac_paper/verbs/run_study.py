"""The common part of ``experiment`` and ``bench``: run a study, and print its findings."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path
from typing import Any

from spikingtac.cli.messages import emit_json, progress, remark
from spikingtac_paper.registry import Runner


def run_study(study: Runner, args: Any) -> int:
    """Run an experiment or a bench with the arguments of its verb, and print its findings.

    Args:
        study: Function of the study.
        args: Arguments of the verb; those with the name of a run option are passed on.
    """
    from spikingtac_paper.harness.run_options import RunOptions

    known = {field.name for field in fields(RunOptions)}
    given = {name: value for name, value in vars(args).items() if name in known}
    with progress(args.name) as advance:
        summary = study(RunOptions(**given, data=recordings_from_elsewhere(), advance=advance))
    if args.json:
        emit_json(summary)
        return 0
    for text in summary["findings"]:
        remark(text)
    remark(f"report: {args.output / 'report.html'}")
    return 0


def recordings_from_elsewhere() -> Path | None:
    """Return the folder in the variable ``SPIKINGTAC_DATA``, or None."""
    folder = os.environ.get("SPIKINGTAC_DATA")
    return Path(folder).absolute() if folder and Path(folder).is_dir() else None
