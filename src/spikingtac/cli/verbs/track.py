"""``spikingtac track``: follow every marker through a recording, or through many."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli.many import ManyArgs, means_many, run_many
from spikingtac.cli.messages import Advance, Table, counted, no_progress, progress, tell
from spikingtac.cli.options import Output
from spikingtac.cli.sources import (
    SecondArgs,
    ask_for_real_time,
    ending_on_interrupt,
    for_each,
    open_two,
    require_live,
    second_name,
)
from spikingtac.config import load_config
from spikingtac.events.address import is_stream
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.open import open_events
from spikingtac.markers.calibration.calibrate import completed
from spikingtac.markers.registry import TrackingConfig
from spikingtac.pipeline.checked_source import CheckedSource, refuse
from spikingtac.pipeline.track import track_to_file
from spikingtac.touch.force.model import load_force
from spikingtac.types import LawName, Polarity


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs, SecondArgs):
    """Follow every marker through a recording and write its displacement over time.

    Many recordings (several paths, a folder, a quoted pattern) go into a folder, with a table of
    all results: spikingtac track DAY --calibration C -o DAY_tracks --workers 4
    """

    recordings: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RECORDING...")
    ]
    """Event file, recording folder, or a camera: its address, a named pipe, or -. Several, a folder
    of recordings or a pattern such as 'day/*.raw' are tracked one by one."""
    calibration: Path
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    output: Output = None
    """File to write: .npz, or .csv and .parquet in long form; tracks.npz unless given. A folder for
    many. The second finger's tracks.npz is tracks_1.npz."""
    preset: str = "default"
    """default (accurate), fast (10 kHz) or paper (as published), or a TOML file."""
    rate_hz: float | None = None
    """Estimates per second; the preset's unless given."""
    polarity: Polarity | None = None
    """White markers on dark ground, or dark on light; the calibration's unless given."""
    hysteresis: LawName | None = None
    """Law of the output position; the calibration's or the preset's unless given."""
    smooth: bool = False
    """For a file: smooth backward in time, and write the places' standard deviations, sigma_px."""
    force: Path | None = None
    """force.onnx: estimate the wrench of every frame, too; make one with: spikingtac force fit."""
    realtime: bool = False
    """For a camera: lock memory, stop garbage collection, and where the system permits it run
    before other work, on one core."""


def run(args: Args) -> int:
    """Track, write, and say what came out."""
    many = means_many(args, args.recordings)
    if args.realtime:
        require_live([*args.recordings, *([args.second] if args.second else ())])
    output = args.output or Path("tracks.npz")
    if args.second is not None:
        return _run_two(args, args.second, output, many)
    if many:
        check = partial(_configured, args, args.calibration)
        return run_many("track", args, track_one, ".npz", check)
    recording = args.recordings[0]
    args.claim(output)
    with progress(f"tracking {recording.name}") as advance:
        summary = _track(args, recording, output, advance)
    return tell(args.json, summary, *_shown(summary, recording))


def _run_two(args: Args, second: Path, output: Path, many: bool) -> int:
    """Track two fingers on the first one's clock."""
    calibrations = args.calibrations(args.calibration, many)
    first, outputs = args.recordings[0], [output, second_name(output)]
    args.claim(*outputs)

    def work(number: int, source: FileSource) -> dict[str, Any]:
        return _track_source(args, source, calibrations[number], outputs[number])

    sources = open_two(first, second, strict=args.strict)
    with ending_on_interrupt(*sources):
        one, other = for_each(work, sources)
    return tell(args.json, one | {"second": other}, *_shown(one, first), *_shown(other, second))


def _track(
    args: Args, recording: Path, output: Path, advance: Advance = no_progress
) -> dict[str, Any]:

    source = open_events(recording, strict=args.strict, sensor=args.sensor)
    return _track_source(args, source, args.calibration, output, advance)


def _track_source(
    args: Args,
    source: FileSource | CheckedSource,
    calibration_path: Path,
    output: Path,
    advance: Advance = no_progress,
) -> dict[str, Any]:

    tracking, calibration = _configured(args, calibration_path)
    force = None if args.force is None else load_force(args.force)
    if tracking.method != "blobs" and not is_stream(source.path):
        calibration = completed(source, calibration)
    if args.strict:
        source = CheckedSource(source, calibration, refuse)
    with ending_on_interrupt(source):
        if args.realtime:
            ask_for_real_time()
        return track_to_file(source, output, tracking, calibration, advance, force)


def _configured(args: Args, calibration_path: Path) -> tuple[TrackingConfig, Calibration]:
    """Return how markers are followed, and the sensor's calibration, as the options say."""
    calibration = Calibration.load(calibration_path)
    config = load_config(args.preset).with_tracking(
        rate_hz=args.rate_hz,
        hysteresis=args.hysteresis or calibration.hysteresis,
        smooth=args.smooth or None,
    )
    return config.tracking, calibration.with_polarity(args.polarity)


def track_one(args: Args, recording: Path, output: Path) -> dict[str, Any]:
    """Track one of many recordings and return its row of the table."""
    summary = _track(args, recording, output)
    same = ("markers", "estimates", "held_share", "displacement_max_px")
    return {name: summary[name] for name in same} | {
        "duration_s": summary["estimates"] / summary["rate_hz"],
        "never_observed": len(summary["never_observed"]),
        "anomalies": sum(summary["anomalies"].values()),
        "calibration_misfit": int(summary["calibration_misfit"] is not None),
    }


def _shown(summary: dict[str, Any], recording: Path) -> list[Table | str]:
    cells = {
        "markers": summary["markers"],
        "estimates": summary["estimates"],
        "rate Hz": f"{summary['rate_hz']:g}",
        "held": f"{summary['held_share']:.2%}",
        "largest displacement px": f"{summary['displacement_max_px']:.2f}",
    }
    if summary.get("force_max_n") is not None:
        cells["largest force N"] = f"{summary['force_max_n']:.3f}"
    misfit = summary["calibration_misfit"]
    return [
        *counted(summary["anomalies"]),
        *(
            f"note: marker {marker} was never observed; its positions are predictions"
            for marker in summary["never_observed"]
        ),
        *([f"warning: {misfit}"] if misfit else []),
        Table(f"tracks of {recording.name}", tuple(cells), [tuple(cells.values())], words=0),
        f"written: {summary['output']}",
    ]
