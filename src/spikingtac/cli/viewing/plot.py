"""``spikingtac plot``: a figure of tracks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from spikingtac.cli.messages import emit_json, remark
from spikingtac.plots.theme import ThemeName, WidthName
from spikingtac.plots.tracks import Kind

if TYPE_CHECKING:
    from spikingtac.tracks import Tracks


@dataclass(frozen=True, kw_only=True)
class Args:
    """Draw tracks: displacement over time, vector field, heat map or strain.

    Lengths are in mm where the calibration knew the pitch (calibrate --pitch-mm), otherwise in px.
    """

    tracks: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TRACKS")]
    """tracks.npz; make it with: spikingtac track."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tracks.png")
    """File to write: .png, .svg or .pdf; .gif animates the field, with the course below."""
    kind: Kind = "course"
    """course: displacement over time; field: arrows; map: heat map; strain: growth of area."""
    at_s: float | None = None
    """Time of a field, map or strain, s since the first estimate; that of the largest displacement
    unless given."""
    from_s: float | None = None
    """Begin of an animation, s since the first estimate; a second before the largest displacement
    unless given."""
    to_s: float | None = None
    """End of an animation, s since the first estimate; a second after the largest displacement
    unless given."""
    slow: float = 1.0
    """Slow-motion factor of an animation: at 2 it lasts twice as long as what it shows."""
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
    from spikingtac.tracks import Tracks

    _check(args)
    require_free(args.output, args.overwrite)
    tracks = Tracks.load(args.tracks)
    pictures = _animate(args, tracks) if args.output.suffix == ".gif" else _draw(args, tracks)
    if args.json:
        told = {"output": str(args.output), "kind": args.kind, "pictures": pictures}
        emit_json({**told, **tracks.summary()})
    else:
        remark(f"written: {args.output}")
    return 0


def _check(args: Args) -> None:
    from spikingtac.errors import ConfigError

    animated = args.output.suffix == ".gif"
    if not animated and (args.from_s is not None or args.to_s is not None or args.slow != 1.0):
        raise ConfigError("--from-s, --to-s and --slow are for animations: -o field.gif")
    if animated and (args.at_s is not None or args.kind not in ("course", "field")):
        raise ConfigError("a .gif shows the field over a stretch: leave out --at-s and --kind")


def _draw(args: Args, tracks: Tracks) -> int:
    from spikingtac.plots.tracks import US_PER_S, plot_tracks, save_figure

    at_us = None
    if args.at_s is not None and len(tracks.t_us):
        at_us = int(tracks.t_us[0]) + round(args.at_s * US_PER_S)
    figure = plot_tracks(tracks, args.kind, at_us=at_us, theme=args.theme, width=args.width)
    save_figure(figure, args.output)
    return 1


def _animate(args: Args, tracks: Tracks) -> int:
    from spikingtac.plots.animation import save_animation

    return save_animation(
        tracks,
        args.output,
        stretch_s=(args.from_s, args.to_s),
        slow=args.slow,
        theme=args.theme,
        width=args.width,
    )
