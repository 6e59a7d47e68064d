"""``spikingtac plot``: a figure of tracks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac.cli.messages import emit_json, remark
from spikingtac.plots.theme import ThemeName, WidthName
from spikingtac.plots.tracks import Kind


@dataclass(frozen=True, kw_only=True)
class Args:
    """Draw tracks: displacement over time, vector field, heat map or strain.

    Lengths are in mm where the calibration knew the pitch (calibrate --pitch-mm), otherwise in px.
    """

    tracks: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TRACKS")]
    """tracks.npz; make it with: spikingtac track."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tracks.png")
    """File to write: .png, .svg or .pdf."""
    kind: Kind = "course"
    """course: displacement over time; field: arrows; map: heat map; strain: growth of area."""
    at_s: float | None = None
    """Time of a field, map or strain, s since the first estimate; that of the largest displacement
    unless given."""
    theme: ThemeName = "light"
    """Colours: light for paper, dark for screens."""
    width: WidthName = "single"
    """Width of one column of a paper (3.5 inches) or of two (7.16 inches)."""
    overwrite: bool = False
    """Replace a file that is already there."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Draw, and write the figure."""
    from spikingtac.atomic_files import require_free
    from spikingtac.plots.tracks import US_PER_S, plot_tracks, save_figure
    from spikingtac.tracks import Tracks

    require_free(args.output, args.overwrite)
    tracks = Tracks.load(args.tracks)
    at_us = None
    if args.at_s is not None and len(tracks.t_us):
        at_us = int(tracks.t_us[0]) + round(args.at_s * US_PER_S)
    figure = plot_tracks(tracks, args.kind, at_us=at_us, theme=args.theme, width=args.width)
    save_figure(figure, args.output)
    if args.json:
        emit_json({"output": str(args.output), "kind": args.kind, **tracks.summary()})
    else:
        remark(f"written: {args.output}")
    return 0
