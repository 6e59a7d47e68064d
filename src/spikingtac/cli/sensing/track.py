"""``spikingtac track``: follow every marker through a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.messages import emit_json, emit_table, progress, remark
from spikingtac.types import LawName, Polarity


@dataclass(frozen=True, kw_only=True)
class Args:
    """Follow every marker through a recording and write its displacement over time."""

    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """Event file, recording folder, or a camera: its address, a named pipe, or -."""
    calibration: Path
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tracks.npz")
    """File to write: .npz, or .csv in long form."""
    preset: str = "default"
    """default (accurate), fast (10 kHz) or paper (as published), or a TOML file."""
    rate_hz: float | None = None
    """Estimates per second; the preset's unless given."""
    polarity: Polarity | None = None
    """White markers on dark ground, or dark on light; the calibration's unless given."""
    hysteresis: LawName | None = None
    """Law of the output position; the calibration's or the preset's unless given."""
    sensor: int = 0
    """In a folder, the sensor to read: 1 reads events_1.raw."""
    force: Path | None = None
    """force.json: tell the wrench of every frame, too; make one with: spikingtac force fit."""
    overwrite: bool = False
    """Replace a file that is already there."""
    strict: bool = False
    """Refuse a damaged recording instead of mending it, and the calibration of another sensor
    instead of a warning."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Track, write, and say what came out."""
    from spikingtac.atomic_files import require_free
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.config import load_config
    from spikingtac.events.open import open_events
    from spikingtac.pipeline.checked_source import CheckedSource, refuse
    from spikingtac.pipeline.recording_tracks import track_to_file

    require_free(args.output, args.overwrite)
    calibration = Calibration.load(args.calibration)
    config = load_config(args.preset).with_tracking(
        rate_hz=args.rate_hz, hysteresis=args.hysteresis or calibration.hysteresis
    )
    force = None
    if args.force is not None:
        from spikingtac.touch.force.files.model_file import load_force

        force = load_force(args.force)
    source = open_events(args.recording, strict=args.strict, sensor=args.sensor)
    if args.strict:
        source = CheckedSource(source, calibration.with_polarity(args.polarity), refuse)
    name = f"tracking {args.recording.name}"
    with ending_on_interrupt(source), progress(name) as advance:
        summary = track_to_file(
            source,
            args.output,
            config.tracking,
            calibration.with_polarity(args.polarity),
            advance,
            force,
        )
    if args.json:
        emit_json(summary)
        return 0
    _print(summary, args)
    return 0


def _print(summary: dict[str, Any], args: Args) -> None:
    for kind, count in summary["anomalies"].items():
        remark(f"note: {kind} {count} times in the recording")
    if summary["calibration_misfit"]:
        remark(f"warning: {summary['calibration_misfit']}")
    for marker in summary["never_observed"]:
        remark(f"note: marker {marker} was never observed; its positions are predictions")
    emit_table(
        f"tracks of {args.recording.name}",
        ("markers", "estimates", "rate Hz", "held", "largest displacement px", "output"),
        [
            (
                summary["markers"],
                summary["estimates"],
                f"{summary['rate_hz']:g}",
                f"{summary['held_share']:.2%}",
                f"{summary['displacement_max_px']:.2f}",
                summary["output"],
            )
        ],
        words=0,
    )
