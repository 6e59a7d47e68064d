"""``spikingtac compare``: two tracks, or tracks and a truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac.batch.run import write_rows
from spikingtac.cli.messages import figures, tell
from spikingtac.cli.options import WriteArgs
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.formats.array_file import load_arrays
from spikingtac.file_kinds import TOLD, kind_of
from spikingtac.plots.figure import ThemeName, WidthName
from spikingtac.tracks import Tracks
from spikingtac.tracks.comparison import Comparison, compare_tracks, compare_with_truth


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Compare two tracks of a recording, or tracks with the truth of a simulated one."""

    one: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TRACKS")]
    """tracks.npz; the distances are computed at its times."""
    other: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OTHER")]
    """Other tracks.npz, a truth.npz, or a recording folder that holds one."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o", "--plot"], metavar="FIGURE")] = None
    """Figure to write (.png, .svg, .pdf): the distance over time and by marker."""
    table: Path | None = None
    """CSV file to write: the distance of each marker."""
    theme: ThemeName = "light"
    """Colours of the figure: light for paper, dark for screens."""
    width: WidthName = "single"
    """Width of the figure: one column of a paper, or two."""


def run(args: Args) -> int:
    """Compare, print the figures, and write what was asked for."""
    args.claim(args.output, args.table)
    found = compared(args.one, args.other)
    summary = found.summary()
    if args.output is not None:
        from spikingtac.plots.figure import save_figure
        from spikingtac.plots.tracks import plot_comparison

        save_figure(plot_comparison(found, theme=args.theme, width=args.width), args.output)
    if args.table is not None:
        rows = found.by_marker()
        texts = [{name: f"{value:.6g}" for name, value in row.items()} for row in rows]
        write_rows(args.table, list(rows[0]), texts)
    written = [f"written: {path}" for path in (args.output, args.table) if path is not None]
    document = {**summary, "by_marker": found.by_marker()}
    return tell(args.json, document, figures(f"{args.one} against {args.other}", summary), *written)


def compared(one: Path, other: Path) -> Comparison:
    """Compare the tracks in a file with tracks or a truth.

    Raises:
        RecordingError: A file cannot be read, or holds neither.
        ConfigError: The two are of other sensors or other times.
    """
    path = other / "truth.npz" if other.is_dir() else other
    kind = kind_of(path)
    events = kind_of(one) in ("recording", "truth") or (one.is_file() and one.suffix != ".npz")
    if kind == "tracks" and events:
        raise ConfigError(f"the tracks come first: spikingtac compare {other} {one}")
    tracks = Tracks.load(one)
    if kind not in ("tracks", "truth") and path.exists():
        told = f": {TOLD[kind]}" if kind else " (marker_t_us and marker_px)"
        raise RecordingError(f"{str(path)!r} holds neither tracks nor a truth{told}")
    if kind == "tracks":
        return compare_tracks(tracks, Tracks.load(path))
    truth = load_arrays(path, "ground truth")
    return compare_with_truth(tracks, truth["marker_t_us"], truth["marker_px"])
