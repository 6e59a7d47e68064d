"""``spikingtac plot`` and ``compare``: figures of tracks, of events, of errors."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import tyro

import spikingtac as st
from spikingtac import events
from spikingtac.batch.run import write_rows
from spikingtac.cli.messages import counted, figures, tell, warn
from spikingtac.cli.options import Output, WriteArgs
from spikingtac.cli.sources import anomalies_of
from spikingtac.file_kinds import TOLD, digest_of, kind_of
from spikingtac.plots.figure import PICTURE_ENDINGS, EventKind, ThemeName, WidthName, save_figure
from spikingtac.plots.tracks import Kind, plot_comparison
from spikingtac.tracks.comparison import Comparison
from spikingtac.types import US_PER_S

OF_ALL_TIMES = ("course", "hot")  # Kinds of plots that show no one moment.


@dataclass(frozen=True, kw_only=True)
class StyleArgs(WriteArgs):
    """How a figure looks.

    Attributes:
        theme: Colours: light for paper, dark for screens.
        width: Width of one column of a paper (3.5 inches) or of two (7.16 inches).
    """

    theme: ThemeName = "light"
    width: WidthName = "single"


@dataclass(frozen=True, kw_only=True)
class Args(StyleArgs):
    """Draw tracks, or the events of any recording; a recording needs no calibration.

    Lengths are in mm where the calibration knew the pitch (calibrate --pitch-mm), otherwise in px.

    Attributes:
        source: tracks.npz; or an event file or a recording folder.
        output: File to write: .png, .svg or .pdf; .gif animates a field of tracks, with the course
            below. tracks.png or events.png unless given.
        kind: Tracks: course (over time, the default), field (arrows), map (heat map), strain (of
            area). Events: moment (ON and OFF), rate, surface (how recent), hot (pixels that never
            rest), overview (the default).
        at_s: Time since the start, s; that of the largest displacement or rate unless given.
        from_s: Begin of an animation, s; a second before the largest displacement unless given.
        to_s: End of an animation, s; a second after the largest displacement unless given.
        slow: Slow-motion factor of an animation: at 2 it lasts twice as long as what it shows.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TRACKS|RECORDING")]
    output: Output = None
    kind: Literal[Kind, EventKind] | None = None
    at_s: float | None = None
    from_s: float | None = None
    to_s: float | None = None
    slow: float = 1.0


def run(args: Args) -> int:
    """Draw, and write the figure."""
    tracked = kind_of(args.source) in ("tracks", "truth")
    output = args.output or Path("tracks.png" if tracked else "events.png")
    kind = args.kind or ("course" if tracked else "overview")
    valid = get_args(Kind if tracked else EventKind)
    if kind not in valid:
        what = "tracks" if tracked else "a recording"
        raise st.ConfigError(f"--kind {kind} is not for {what} (valid: {', '.join(valid)})")
    animated = output.suffix.lower() == ".gif"
    args.refuse("is for an animation: -o field.gif", "from_s", "to_s", "slow", where=not animated)
    if animated and not tracked:
        raise st.ConfigError("a .gif shows tracks; spikingtac view RECORDING --export shows events")
    if animated and kind not in ("course", "field"):
        raise st.ConfigError(f"a .gif shows the field, not the {kind}; leave out --kind")
    args.refuse("is for one moment", "at_s", where=animated or kind in OF_ALL_TIMES)
    args.claim(output, endings=(*PICTURE_ENDINGS, ".gif"))
    told = _of_tracks(args, output, kind) if tracked else _of_events(args, output, kind)
    document = {"output": str(output), "kind": kind, **told}
    return tell(args.json, document, *counted(told.get("anomalies", {})), f"written: {output}")


def _of_events(args: Args, output: Path, kind: str) -> dict[str, Any]:
    from spikingtac.plots.events import event_figures, plot_events

    if events.is_stream(args.source):
        raise st.ConfigError(f"{str(args.source)!r} is a live source; record it first, or view it")
    source = st.open_events(args.source)
    found = event_figures(source, args.at_s)
    save_figure(plot_events(found, kind, theme=args.theme, width=args.width), output)
    count, hot_px = int(found.counts.sum()), found.hot_px.tolist()
    told = {"pictures": 1, "at_us": found.at_us, "events": count, "hot_px": hot_px}
    return told | {"anomalies": anomalies_of(source)}


def _of_tracks(args: Args, output: Path, kind: str) -> dict[str, Any]:
    from spikingtac.plots.moments import save_animation

    tracks = st.Tracks.load(args.source)
    style: dict[str, Any] = {"theme": args.theme, "width": args.width}
    if output.suffix.lower() == ".gif":
        stretch_s = args.from_s, args.to_s
        pictures = save_animation(tracks, output, stretch_s=stretch_s, slow=args.slow, **style)
        return {"pictures": pictures, **tracks.summary()}
    at_us = None
    if args.at_s is not None and len(tracks.t_us):
        at_us = int(tracks.t_us[0]) + round(args.at_s * US_PER_S)
    save_figure(st.plot_tracks(tracks, kind, at_us=at_us, **style), output)
    return {"pictures": 1, **tracks.summary()}


@dataclass(frozen=True, kw_only=True)
class CompareArgs(StyleArgs):
    """Compare two tracks of a recording, or tracks with the truth of a simulated one.

    Attributes:
        one: tracks.npz; the distances are computed at its times.
        other: Other tracks.npz, a truth.npz, or a recording folder that holds one.
        output: Figure to write (.png, .svg, .pdf): the distance over time and by marker.
        table: CSV file to write: the distance of each marker.
    """

    one: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TRACKS")]
    other: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OTHER")]
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o", "--plot"], metavar="FIGURE")] = None
    table: Path | None = None


def compare(args: CompareArgs) -> int:
    """Compare, print the figures, and write what was asked for."""
    args.refuse("is for a figure: -o compared.png", "theme", "width", where=args.output is None)
    args.claim(args.output, endings=PICTURE_ENDINGS)
    args.claim(args.table, endings=(".csv",))
    found = compared(args.one, args.other)
    summary, rows = found.summary(), found.by_marker()
    if args.output is not None:
        save_figure(plot_comparison(found, theme=args.theme, width=args.width), args.output)
    if args.table is not None:
        texts = [{name: f"{value:.6g}" for name, value in row.items()} for row in rows]
        write_rows(args.table, list(rows[0]), texts)
    written = [f"written: {path}" for path in (args.output, args.table) if path is not None]
    table = figures(f"{args.one} against {args.other}", summary)
    return tell(args.json, {**summary, "by_marker": rows}, table, *written)


def compared(one: Path, other: Path) -> Comparison:
    """Compare the tracks in a file with tracks or a truth.

    Raises:
        RecordingError: A file cannot be read, or holds neither.
        ConfigError: The two are of other sensors or other times.
    """
    path = other / "truth.npz" if other.is_dir() else other
    kind = kind_of(path)
    if kind == "tracks" and kind_of(one) in ("recording", "truth"):
        raise st.ConfigError(f"the tracks come first: spikingtac compare {other} {one}")
    tracks = st.Tracks.load(one)
    if kind not in ("tracks", "truth") and path.exists():
        told = f": {TOLD[kind]}" if kind else " (marker_t_us and marker_px)"
        raise st.RecordingError(f"{str(path)!r} holds neither tracks nor a truth{told}")
    if kind == "tracks":
        return st.compare_tracks(tracks, st.Tracks.load(path))
    truth, known = events.load_truth(path), tracks.meta.get("input_sha256")
    if known and digest_of(path.parent / str(tracks.meta.get("input"))) not in (None, known):
        warn("the tracks are of another recording than the truth; compare those of one recording")
    return st.compare_with_truth(tracks, truth["marker_t_us"], truth["marker_px"])
