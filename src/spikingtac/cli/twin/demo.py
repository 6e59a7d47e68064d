"""``spikingtac demo``: see the sensor work within a minute, without hardware."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac.cli.messages import remark
from spikingtac.cli.viewing.view import check_seconds, report, show_source

SCENE = "demo"


@dataclass(frozen=True, kw_only=True)
class Args:
    """A finger presses, twists and slides on the simulated skin; watch it in the browser.

    Gel, optics and event camera are simulated as you watch; the tracker sees only the events.
    """

    preset: str = "default"
    """default, fast or paper, or a TOML file."""
    seed: int = 1
    """Seed of place, depth and speed of the finger."""
    host: str = "127.0.0.1"
    """Address to serve on; beyond loopback the printed address carries a random token."""
    port: int = 8765
    """Port, or 0 for any free one."""
    no_browser: bool = False
    """Serve the page, but open no browser."""
    headless: bool = False
    """Without a page: follow the scene for --seconds, and print the summary."""
    seconds: float | None = None
    """Duration, s; without end unless given (10 with --headless)."""
    picture: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """File for a summary picture (.png, .svg, .pdf); the tracks are written beside it. Nothing is
    written unless given."""
    overwrite: bool = False
    """Replace files that are already there."""
    json: bool = False
    """Print one JSON object at the end."""


def run(args: Args) -> int:
    """Simulate, track and serve, and print the summary at the end."""
    from spikingtac.viewer.export import tracks_beside

    check_seconds(args.seconds)
    remark("simulating a finger on the skin; the first start compiles its kernels")
    arguments = {"source": SCENE, "preset": args.preset, "seed": args.seed}
    tracks = tracks_beside(args.picture) if args.picture else None
    report(SCENE, show_source(arguments, args, repeat=True, tracks=tracks), as_json=args.json)
    return 0
