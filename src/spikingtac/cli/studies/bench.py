"""``spikingtac bench``: rates and latencies of this machine, beside tuned peers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac.cli.studies.experiment import run_and_tell


@dataclass(frozen=True, kw_only=True)
class Args:
    """Measure how fast this machine tracks, beside tuned peers on the same stream."""

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="NAME")] = "throughput"
    """throughput."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")]
    """Folder to write; new or empty, or begun with the same settings (--resume)."""
    quick: bool = False
    """Shorter streams and 5 s of pacing instead of 30 s."""
    seed: int = 0
    """Of the stream."""
    resume: bool = False
    """Go on with a bench that was interrupted."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Run it, and say what came out."""
    from spikingtac.experiments import BENCHES, runner_of

    return run_and_tell(runner_of(BENCHES, args.name, "bench"), args)
