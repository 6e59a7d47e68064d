"""Measure how fast this machine tracks, beside tuned peers on the same stream."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from spikingtac_paper.registry import BENCHES, choices_text, run_study
from spikingtac_paper.verbs.experiment import RunArgs


@dataclass(frozen=True, kw_only=True)
class Args(RunArgs):
    """Measure how fast this machine tracks, beside tuned peers on the same stream."""

    name: Annotated[
        tyro.conf.Positional[str],
        tyro.conf.arg(metavar="NAME", help=f"Name of the bench: {choices_text(BENCHES)}"),
    ] = "throughput"


def run(args: Args) -> int:
    """Run the bench and print its findings."""
    return run_study(BENCHES, "bench", args)
