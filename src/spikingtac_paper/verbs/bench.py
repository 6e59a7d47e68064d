"""Measure how fast this machine tracks, beside tuned peers on the same stream."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac_paper.registry import BENCHES, choices_text, run_study


@dataclass(frozen=True, kw_only=True)
class Args:
    """Measure how fast this machine tracks, beside tuned peers on the same stream."""

    name: Annotated[
        tyro.conf.Positional[str],
        tyro.conf.arg(metavar="NAME", help=f"Name of the bench: {choices_text(BENCHES)}"),
    ] = "throughput"
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")]
    """Folder to write: new or empty, or one that was begun with the same settings (--resume)."""
    quick: bool = False
    """Use shorter streams, and paced runs of 5 s instead of 30 s."""
    seed: int = 0
    """Seed of the stream."""
    resume: bool = False
    """Continue a bench that was interrupted."""
    overwrite: bool = False
    """Remove the run that is in the folder, and begin anew."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Run the bench and print its findings."""
    return run_study(BENCHES, "bench", args)
