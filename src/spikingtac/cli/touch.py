"""``spikingtac touch``: list the touches in a recording: when, where, how large, how they hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.atomic_files import require_free
from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.many import means_many, require_folder, run_many
from spikingtac.cli.messages import emit_json, progress, remark, warn
from spikingtac.cli.touch_rows import (
    print_rows,
    print_vibration,
    touch_row,
    vibration_row,
    write_rows,
)
from spikingtac.cli.touch_watch import WatchArgs, Watched, track, watch
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.touch.ageing import Swing


VIBRATION_WINDOW_S = 1.0
"""Length of a spectrum of vibration, s: bins of 1 Hz."""


@dataclass(frozen=True, kw_only=True)
class Args(WatchArgs):
    """List the touches in a recording: begin, end, place, area, peak and slips of each.

    This verb tells touches apart and measures them, some 20 to 60 ms after they begin. To stop a
    robot within a millisecond, use: spikingtac contact.

    Of many recordings, the lists go into a folder, with a table of all results and a report:
    spikingtac touch DAY --calibration C -o DAY_touches --workers 4
    """

    sources: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SOURCE...")]
    """Event file, recording folder or camera, with --calibration; or tracks.npz, or arrays t_us,
    reference_mm, displacement_mm. Several, folders of them, patterns such as 'day/*.raw'."""
    second: Annotated[Path | None, tyro.conf.arg(metavar="SOURCE")] = None
    """The other finger: its recording or camera, put on the first one's clock."""
    second_calibration: Path | None = None
    """calibration.json of the other finger."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """CSV file to write, one line per touch; a folder for many. The second finger's touches.csv is
    touches_1.csv."""


@dataclass(frozen=True, slots=True)
class _Found:
    """The touches of a recording as rows, and where they are from."""

    rows: list[dict[str, Any]]
    first_us: int | None
    watched: Watched
    swing: Swing | None
    lines: list[dict[str, Any]] | None


def run(args: Args) -> int:
    """Follow the markers, find the touches, and list them."""
    many = means_many(args, args.sources)
    if args.second is not None:
        return _run_two(args, many)
    if many:
        return _run_many(args)
    source = args.sources[0]
    if args.output is not None:
        require_free(args.output, args.overwrite)
    with progress(f"watching {source.name}") as advance:
        found = _find(args, source, advance)
    if args.output is not None:
        write_rows(args.output, found.rows)
    if args.json:
        emit_json(_document(found))
    else:
        _print(found, source, found.first_us)
    return 0


def _run_two(args: Args, many: bool) -> int:
    """List the touches of two fingers on the first one's clock."""
    from spikingtac.cli.second import for_each, open_two, require_pair, second_name

    calibrations = require_pair(args.calibration, args.second_calibration, many)
    assert args.second is not None
    paths = [] if args.output is None else [args.output, second_name(args.output)]
    for path in paths:
        require_free(path, args.overwrite)
    sources = open_two(args.sources[0], args.second, strict=args.strict)
    with ending_on_interrupt(*sources):
        both = for_each(
            lambda number, source: _listed(args, track(args, source, calibrations[number])), sources
        )
    for path, found in zip(paths, both, strict=False):
        write_rows(path, found.rows)
    if args.json:
        emit_json({**_document(both[0]), "second": _document(both[1])})
        return 0
    for found, source in zip(both, (args.sources[0], args.second), strict=True):
        _print(found, source, both[0].first_us)
    return 0


def _document(found: _Found) -> dict[str, Any]:
    watched = found.watched
    return {
        "t_first_us": found.first_us,
        "touches": found.rows,
        "anomalies": watched.anomalies,
        "health": watched.health or None,
        "vibration": found.lines,
        "swing": None if found.swing is None else round(found.swing.share, 3),
    }


def _run_many(args: Args) -> int:
    from spikingtac.batch.inputs import SERIES_MEMBERS, find_recordings
    from spikingtac.batch.run import Batch
    from spikingtac.config import load_config

    if args.vibration:
        raise ConfigError("--vibration works on one recording at a time; name one")
    folder = require_folder(args.output, "touch")
    load_config(args.preset)  # what is wrong for all of them is refused before any work is done
    preset = Path(args.preset)
    batch = Batch(
        name="touch",
        work=touch_one,
        recordings=find_recordings(args.sources, SERIES_MEMBERS, apart_from=folder),
        folder=folder,
        ending=".csv",
        settings={
            "calibration": None if args.calibration is None else str(args.calibration.absolute()),
            "preset": str(preset.absolute()) if preset.suffix == ".toml" else args.preset,
            "rate_hz": args.rate_hz,
            "sensor": args.sensor,
            "strict": args.strict,
        },
    )
    return run_many(batch, args)


def touch_one(settings: Mapping[str, Any], recording: Path, output: Path) -> dict[str, Any]:
    """List the touches of one of many recordings and return its row of the table."""
    calibration = settings["calibration"]
    path = None if calibration is None else Path(calibration)
    found = _find(Args(**{"sources": (recording,), **settings, "calibration": path}), recording)
    write_rows(output, found.rows)
    ended = [row["duration_us"] for row in found.rows if row["duration_us"] is not None]
    return {
        "touches": len(found.rows),
        "touching_s": sum(ended) / 1e6,
        "slips": sum(len(row["slips"] or []) for row in found.rows),
        "peak_strength_max": max((row["peak_strength"] for row in found.rows), default=0.0),
        "anomalies": sum(found.watched.anomalies.values()),
    }


def _find(
    args: Args, source: Path, advance: Callable[[float], None] = lambda share: None
) -> _Found:
    return _listed(args, watch(args, source, advance))


def _listed(args: Args, watched: Watched) -> _Found:
    from spikingtac.touch.slip.held import HeldTouchDetector
    from spikingtac.touch.touch import TouchConfig
    from spikingtac.touch.vibration import VibrationMonitor

    config = TouchConfig.for_unit(watched.reference, watched.unit)
    detector = HeldTouchDetector(watched.reference, config)
    monitor = VibrationMonitor(watched.rate_hz, VIBRATION_WINDOW_S) if args.vibration else None
    found, lines, first_us, asked_us = [], [], None, 0
    for frame in watched.frames:
        if first_us is None:
            first_us = asked_us = frame.t_us
        held = detector.update(frame)
        if held is not None:
            found.append(held)
        if monitor is None:
            continue
        monitor.update(frame.t_us, frame.detected_px - watched.reference)
        if frame.t_us - asked_us >= monitor.window_us:
            asked_us = frame.t_us
            spectrum = monitor.spectrum()
            if spectrum is not None and spectrum.line_hz is not None:
                lines.append(vibration_row(spectrum, watched.unit, watched.px_per_mm))
    last = detector.finish()
    found += [] if last is None else [last]
    swing = watched.swing()
    if swing is not None and swing.faded:
        warn(swing.words())
    rows = [touch_row(held, watched.unit, watched.scale) for held in found]
    return _Found(rows, first_us, watched, swing, None if monitor is None else lines)


def _print(found: _Found, source: Path, since_us: int | None) -> None:
    for kind, count in found.watched.anomalies.items():
        remark(f"note: {kind} {count} times in the recording")
    scale, since_us = found.watched.px_per_mm, since_us or 0
    print_rows(source.name, found.rows, scale, since_us)
    if found.lines is not None:
        print_vibration(source.name, found.lines, scale, since_us)
