"""``spikingtac plot``: a figure of tracks, or of the events of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

import tyro

from spikingtac.cli.messages import tell
from spikingtac.cli.options import Output, WriteArgs
from spikingtac.errors import ConfigError
from spikingtac.events.open import open_events
from spikingtac.file_kinds import kind_of
from spikingtac.plots.events import EventKind
from spikingtac.plots.figure import ThemeName, WidthName
from spikingtac.plots.tracks import Kind
from spikingtac.tracks import Tracks


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Draw tracks, or the events of any recording; a recording needs no calibration.

    Lengths are in mm where the calibration knew the pitch (calibrate --pitch-mm), otherwise in px.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TRACKS|RECORDING")]
    """tracks.npz; or an event file or a recording folder."""
    output: Output = None
    """File to write: .png, .svg or .pdf; .gif animates a field of tracks, with the course below.
    tracks.png or events.png unless given."""
    kind: Kind | EventKind | None = None
    """Tracks: course (displacement over time), field (arrows), map (heat map), strain (growth of
    area). Events: moment (ON and OFF), rate (over time), surface (how recent), hot (hot pixels),
    or overview (all four). course or overview unless given."""
    at_s: float | None = None
    """Time of a field, map, strain, moment or surface, s since the first estimate or event; that of
    the largest displacement or rate unless given."""
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


def run(args: Args) -> int:
    """Draw, and write the figure."""
    tracked = kind_of(args.source) in ("tracks", "truth")
    output = args.output or Path("tracks.png" if tracked else "events.png")
    kind = args.kind or ("course" if tracked else "overview")
    valid = get_args(Kind if tracked else EventKind)
    if kind not in valid:
        what = "tracks" if tracked else "a recording"
        raise ConfigError(f"--kind {kind} is not for {what} (valid: {', '.join(valid)})")
    _check(args, output, kind, tracked)
    args.claim(output)
    told = _of_tracks(args, output, kind) if tracked else _of_events(args, output, kind)
    document = {"output": str(output), "kind": kind, **told}
    return tell(args.json, document, f"written: {output}")


def _check(args: Args, output: Path, kind: str, tracked: bool) -> None:
    animated = output.suffix == ".gif"
    if not animated and (args.from_s is not None or args.to_s is not None or args.slow != 1.0):
        raise ConfigError("--from-s, --to-s and --slow are for animations: -o field.gif")
    if animated and not tracked:
        raise ConfigError("a .gif shows tracks; spikingtac view RECORDING --export shows events")
    if animated and (args.at_s is not None or kind not in ("course", "field")):
        raise ConfigError("a .gif shows the field over a stretch: leave out --at-s and --kind")


def _of_events(args: Args, output: Path, kind: str) -> dict[str, Any]:
    from spikingtac.plots.events import event_figures, plot_events
    from spikingtac.plots.figure import save_figure

    figures = event_figures(open_events(args.source), args.at_s)
    save_figure(plot_events(figures, kind, theme=args.theme, width=args.width), output)
    return {
        "pictures": 1,
        "at_us": figures.at_us,
        "events": int(figures.counts.sum()),
        "hot_px": figures.hot_px.tolist(),
    }


def _of_tracks(args: Args, output: Path, kind: str) -> dict[str, Any]:
    from spikingtac.plots.animation import save_animation
    from spikingtac.plots.figure import US_PER_S, save_figure
    from spikingtac.plots.tracks import plot_tracks

    tracks = Tracks.load(args.source)
    style: dict[str, Any] = {"theme": args.theme, "width": args.width}
    if output.suffix == ".gif":
        stretch_s = args.from_s, args.to_s
        pictures = save_animation(tracks, output, stretch_s=stretch_s, slow=args.slow, **style)
        return {"pictures": pictures, **tracks.summary()}
    at_us = None
    if args.at_s is not None and len(tracks.t_us):
        at_us = int(tracks.t_us[0]) + round(args.at_s * US_PER_S)
    save_figure(plot_tracks(tracks, kind, at_us=at_us, **style), output)
    return {"pictures": 1, **tracks.summary()}
