"""``spikingtac track``: follow every marker through a recording, or through many."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.cli.deadlines import ask_for_real_time, require_live
from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.many import ManyArgs, means_many, require_folder, run_many
from spikingtac.cli.messages import emit_json, emit_table, progress, remark, warn
from spikingtac.types import LawName, Polarity

if TYPE_CHECKING:
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.events.formats.file_source import FileSource
    from spikingtac.markers.tracking_config import TrackingConfig
    from spikingtac.pipeline.checked_source import CheckedSource
    from spikingtac.touch.force.model import ForceModel


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs):
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
    second: Annotated[Path | None, tyro.conf.arg(metavar="RECORDING")] = None
    """The other finger: its recording or camera, put on the first one's clock."""
    second_calibration: Path | None = None
    """calibration.json of the other finger."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
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
    if args.second is not None:
        return _run_two(args, many)
    if many:
        return _run_many(args)
    from spikingtac.atomic_files import require_free

    recording, output = args.recordings[0], args.output or Path("tracks.npz")
    require_free(output, args.overwrite)
    with progress(f"tracking {recording.name}") as advance:
        summary = _track(args, recording, output, advance)
    if args.json:
        emit_json(summary)
        return 0
    _print(summary, recording)
    return 0


def _run_two(args: Args, many: bool) -> int:
    """Track two fingers on the first one's clock."""
    from spikingtac.atomic_files import require_free
    from spikingtac.cli.second import for_each, open_two, require_pair, second_name

    calibrations = require_pair(args.calibration, args.second_calibration, many)
    assert args.second is not None
    output = args.output or Path("tracks.npz")
    outputs = [output, second_name(output)]
    for path in outputs:
        require_free(path, args.overwrite)
    sources = open_two(args.recordings[0], args.second, strict=args.strict)

    def work(number: int, source: FileSource) -> dict[str, Any]:
        return _track_source(args, source, calibrations[number], outputs[number])

    with ending_on_interrupt(*sources):
        both = for_each(work, sources)
    if args.json:
        emit_json({**both[0], "second": both[1]})
        return 0
    for summary, recording in zip(both, (args.recordings[0], args.second), strict=True):
        _print(summary, recording)
    return 0


def _track(
    args: Args, recording: Path, output: Path, advance: Callable[[float], None] = lambda share: None
) -> dict[str, Any]:
    from spikingtac.events.open import open_events

    source = open_events(recording, strict=args.strict, sensor=args.sensor)
    return _track_source(args, source, args.calibration, output, advance)


def _track_source(
    args: Args,
    source: FileSource | CheckedSource,
    calibration_path: Path,
    output: Path,
    advance: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    from spikingtac.events.evt.raw_stream import is_stream
    from spikingtac.markers.calibration.calibrate import completed
    from spikingtac.pipeline.checked_source import CheckedSource, refuse
    from spikingtac.pipeline.track import track_to_file

    tracking, calibration = _configured(args, calibration_path)
    force = _force_of(args)
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
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.config import load_config

    calibration = Calibration.load(calibration_path)
    config = load_config(args.preset).with_tracking(
        rate_hz=args.rate_hz, hysteresis=args.hysteresis or calibration.hysteresis
    )
    return config.tracking, calibration.with_polarity(args.polarity)


def _force_of(args: Args) -> ForceModel | None:
    """Return the force model that the options name, or None."""
    if args.force is None:
        return None
    from spikingtac.touch.force.model import load_force

    return load_force(args.force)


def _run_many(args: Args) -> int:
    from spikingtac.batch.inputs import find_recordings
    from spikingtac.batch.run import Batch
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.config import load_config

    folder = require_folder(args.output, "track")
    # What is wrong for all of them is refused before any work is done.
    Calibration.load(args.calibration)
    load_config(args.preset)
    batch = Batch(
        name="track",
        work=track_one,
        recordings=find_recordings(args.recordings, apart_from=folder),
        folder=folder,
        ending=".npz",
        settings=_settings(args),
    )
    return run_many(batch, args)


def _settings(args: Args) -> dict[str, Any]:
    """Return what a worker needs to know, with paths that hold wherever it runs."""
    preset = Path(args.preset)
    return {
        "calibration": str(args.calibration.absolute()),
        "preset": str(preset.absolute()) if preset.suffix == ".toml" else args.preset,
        "rate_hz": args.rate_hz,
        "polarity": args.polarity,
        "hysteresis": args.hysteresis,
        "sensor": args.sensor,
        "force": None if args.force is None else str(args.force.absolute()),
        "strict": args.strict,
    }


def track_one(settings: Mapping[str, Any], recording: Path, output: Path) -> dict[str, Any]:
    """Track one of many recordings and return its row of the table."""
    paths = {
        name: None if settings[name] is None else Path(settings[name])
        for name in ("calibration", "force")
    }
    args = Args(**{"recordings": (recording,), "output": output, **settings, **paths})
    summary = _track(args, recording, output)
    return {
        "markers": summary["markers"],
        "estimates": summary["estimates"],
        "duration_s": summary["estimates"] / summary["rate_hz"],
        "held_share": summary["held_share"],
        "displacement_max_px": summary["displacement_max_px"],
        "never_observed": len(summary["never_observed"]),
        "anomalies": sum(summary["anomalies"].values()),
        "calibration_misfit": int(summary["calibration_misfit"] is not None),
        "swing": summary["swing"],
    }


def _print(summary: dict[str, Any], recording: Path) -> None:
    for kind, count in summary["anomalies"].items():
        remark(f"note: {kind} {count} times in the recording")
    if summary["calibration_misfit"]:
        warn(summary["calibration_misfit"])
    if summary.get("ageing"):
        warn(summary["ageing"])
    for marker in summary["never_observed"]:
        remark(f"note: marker {marker} was never observed; its positions are predictions")
    emit_table(
        f"tracks of {recording.name}",
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
