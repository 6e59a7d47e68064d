"""``spikingtac export``: tracks as a data set for robot learning."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from spikingtac.cli.messages import figures, progress, tell
from spikingtac.cli.options import WriteArgs
from spikingtac.datasets.export import ExportConfig, export


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Write tracks as a data set: LeRobot (v3.0), or Zarr.

    A LeRobot data set has one episode for each recording, with the last values before each frame,
    of the tracks and of a robot's log. A Zarr store has the arrays of tracks.npz at full rate.
    """

    sources: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="TRACKS...")]
    """tracks.npz, several, folders of them, or patterns such as 'day/*.npz'."""
    to: Literal["lerobot", "zarr"]
    """Form of the data set."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write."""
    fps: int = 30
    """LeRobot: frames per second."""
    task: str = "touch"
    """LeRobot: what is done in the recordings, in words."""
    log: tuple[Path, ...] = ()
    """LeRobot: a robot's log for each recording: .npz with t_us on the clock of the tracks, and
    state (n, k), action (n, k) or both."""


def run(args: Args) -> int:
    """Export, and say what was written."""
    names = ("sources", "output", "fps", "task")
    given = {name: getattr(args, name) for name in names}
    config = ExportConfig(**given, form=args.to, logs=args.log)
    with progress(f"exporting to {args.to}") as advance:
        found = export(config, args.overwrite, advance)
    return tell(args.json, found, figures(f"{args.to} data set", found))
