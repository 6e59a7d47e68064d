"""``spikingtac demo``: see the sensor work within a minute, without hardware."""

from __future__ import annotations

from dataclasses import dataclass

from spikingtac.cli.messages import remark
from spikingtac.cli.verbs.view import PageArgs, report, show_source

SCENE = "demo"


@dataclass(frozen=True, kw_only=True)
class Args(PageArgs):
    """A finger presses, twists and slides on the simulated skin; watch it in the browser.

    Gel, optics and event camera are simulated as you watch; the tracker sees only the events.
    """

    seed: int = 1
    """Seed of place, depth and speed of the finger."""


def run(args: Args) -> int:
    """Simulate, track and serve, and print the summary at the end."""
    remark("simulating a finger on the skin; the first start compiles its kernels")
    arguments = {"source": SCENE, "preset": args.preset, "seed": args.seed}
    summary = show_source(arguments, args, repeat=True)
    return report(SCENE, summary, as_json=args.json)
