"""``spikingtac track``: follow every marker through a recording, or through many."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

import spikingtac as st
from spikingtac import events
from spikingtac.cli.messages import UNTRACKED, Advance, Table, counted
from spikingtac.cli.options import Output, RealtimeArgs, TrackerArgs
from spikingtac.cli.recordings import ManyArgs, SecondArgs, Work, run_each
from spikingtac.cli.sources import ask_for_real_time, checked, ending_on_interrupt, require_live
from spikingtac.tracks.files import FORMS
from spikingtac.types import LawName, Polarity


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs, TrackerArgs, SecondArgs, RealtimeArgs):
    """Follow every marker through a recording and write its displacement over time.

    Many recordings (several paths, a folder, a quoted pattern) go into a folder, with a table of
    all results: spikingtac track DAY --calibration C -o DAY_tracks --workers 4

    Attributes:
        recordings: Event files, recording folders, folders of them, patterns such as 'day/*.raw';
            or a camera: its address, a named pipe, or -.
        output: File to write: .npz, .csv, .parquet; tracks.npz unless given, tracks_1.npz of
            --second. A folder for many.
        polarity: White markers on dark ground, or dark on light; the calibration's unless given.
        hysteresis: Law of the output position; the calibration's or the preset's unless given.
        smooth: For a file: smooth backward in time, and write the places' standard deviations,
            sigma_px.
        force: force.onnx: estimate the wrench of every frame, too; make one with: spikingtac force
            fit.
    """

    recordings: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RECORDING...")
    ]
    output: Output = None
    polarity: Polarity | None = None
    hysteresis: LawName | None = None
    smooth: bool = False
    force: Path | None = None

    def settings(self) -> tuple[st.Config, st.Calibration]:
        """Return how markers are followed, and the sensor's calibration, as the options say."""
        calibration = st.Calibration.load(self.needed_calibration())
        if self.polarity is not None:
            calibration = replace(calibration, polarity=self.polarity)
        config = st.load_config(self.preset).with_tracking(
            rate_hz=self.rate_hz,
            hysteresis=self.hysteresis or calibration.hysteresis,
            smooth=self.smooth or None,
        )
        return config, calibration


def run(args: Args) -> int:
    """Track, write, and say what came out."""
    sources = [*args.recordings, *([args.second] if args.second else ())]
    require_live(sources, where=args.realtime)
    return run_each(WORK, args, args.recordings, args.output or Path("tracks.npz"))


def track_one(
    args: Args, recording: Path | events.FileSource, output: Path, advance: Advance
) -> dict[str, Any]:
    """Track a recording into a file, and return the summary."""
    from spikingtac.markers.calibration.calibrate import completed
    from spikingtac.pipeline.track import require_same_size, track_to_file

    config, calibration = args.settings()
    source = args.open(recording)
    require_same_size(source.size, calibration.size)
    force = None if args.force is None else st.load_force(args.force)
    if config.tracking.method != "blobs" and not events.is_stream(source.path):
        calibration = completed(source, calibration)
    if args.strict:
        source = checked(source, calibration, strict=True)
    with ending_on_interrupt(source):
        if args.realtime:
            ask_for_real_time()
        return track_to_file(source, output, config.tracking, calibration, advance, force)


def track_row(found: dict[str, Any]) -> dict[str, Any]:
    """Return the row of one of many recordings."""
    same = ("markers", "estimates", "held_share", "displacement_max_px")
    return {name: found[name] for name in same} | {
        "duration_s": found["estimates"] / found["rate_hz"],
        "never_observed": len(found["never_observed"]),
        "anomalies": sum(found["anomalies"].values()),
        "calibration_misfit": int(found["calibration_misfit"] is not None),
    }


def track_shown(found: dict[str, Any], name: str, first: dict[str, Any]) -> list[Table | str]:
    """Return what a reader sees."""
    cells = {
        "markers": found["markers"],
        "estimates": found["estimates"],
        "rate Hz": f"{found['rate_hz']:g}",
        "held": f"{found['held_share']:.2%}",
        "largest displacement px": f"{found['displacement_max_px']:.2f}",
    }
    if found.get("force_max_n") is not None:
        cells["largest force N"] = f"{found['force_max_n']:.3f}"
    told = "note: marker {} was never observed; its positions are predictions"
    return [
        *counted(found["anomalies"]),
        *([] if found["estimates"] else [UNTRACKED]),
        *(told.format(marker) for marker in found["never_observed"]),
        *([f"warning: {misfit}"] if (misfit := found["calibration_misfit"]) else []),
        Table(f"tracks of {name}", tuple(cells), [tuple(cells.values())], words=0),
    ]


WORK = Work("track", track_one, track_row, track_shown, tuple(FORMS), check=Args.settings)
