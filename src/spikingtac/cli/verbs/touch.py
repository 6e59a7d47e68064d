"""``spikingtac touch``: list the touches in a recording: when, where, how large, how they hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from spikingtac.batch.inputs import SERIES_MEMBERS
from spikingtac.calibration.lens import SkinScale
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli.many import ManyArgs, means_many, run_many
from spikingtac.cli.messages import Advance, Table, counted, no_progress, progress, tell, warn
from spikingtac.cli.options import Output, TrackerArgs
from spikingtac.cli.sources import SecondArgs, ending_on_interrupt, for_each, open_two, second_name
from spikingtac.cli.verbs.touch_rows import (
    touch_row,
    touch_table,
    vibration_row,
    vibration_table,
    write_touches,
)
from spikingtac.config import load_config
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.open import open_events
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.checked_source import CheckedSource, refuse
from spikingtac.pipeline.follow import follow
from spikingtac.pipeline.track import require_same_size
from spikingtac.touch.force.series import is_series, load_series
from spikingtac.touch.slip.held import HeldTouchDetector
from spikingtac.touch.touch import TouchConfig
from spikingtac.touch.vibration import VibrationMonitor
from spikingtac.tracks import Tracks
from spikingtac.types import MarkerFrame

VIBRATION_WINDOW_S = 1.0  # Length of a spectrum of vibration, s: bins of 1 Hz.
PROGRESS_EVERY = 256  # Frames between two reports of progress.


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs, TrackerArgs, SecondArgs):
    """List the touches in a recording: begin, end, place, area, peak and slips of each.

    This verb tells touches apart and measures them, some 20 to 60 ms after they begin. To stop a
    robot within a millisecond, use: spikingtac contact.

    Of many recordings, the lists go into a folder, with a table of all results:
    spikingtac touch DAY --calibration C -o DAY_touches --workers 4
    """

    sources: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SOURCE...")]
    """Event file, recording folder or camera, with --calibration; or tracks.npz, or arrays t_us,
    reference_mm, displacement_mm. Several, folders of them, patterns such as 'day/*.raw'."""
    vibration: bool = False
    """Report the strongest line of vibration in every second, from the markers' mean motion."""
    output: Output = None
    """CSV file to write, one line per touch; a folder for many. The second finger's touches.csv is
    touches_1.csv."""


@dataclass(frozen=True, slots=True)
class _Watched:
    """Frames with what is needed to read them; lengths are in ``unit``."""

    frames: Iterator[MarkerFrame]
    reference: Any
    unit: str
    scale: SkinScale | None
    rate_hz: float
    anomalies: dict[str, int] = field(default_factory=dict)
    health: dict[str, float] = field(default_factory=dict)


def run(args: Args) -> int:
    """Follow the markers, find the touches, and list them."""
    many = means_many(args, args.sources)
    if args.second is not None:
        return _run_two(args, args.second, many)
    if many:
        return _run_many(args)
    source = args.sources[0]
    args.claim(args.output)
    with progress(f"watching {source.name}") as advance:
        found = _listed(args, _watch(args, source, advance))
    shown = _shown(found, source.name, found["t_first_us"])
    if args.output is not None:
        write_touches(args.output, found["touches"])
        shown.append(f"written: {args.output}")
    return tell(args.json, found, *shown)


def _run_two(args: Args, second: Path, many: bool) -> int:
    """List the touches of two fingers on the first one's clock."""
    calibrations = args.calibrations(args.calibration, many)
    paths = [] if args.output is None else [args.output, second_name(args.output)]
    args.claim(*paths)

    def work(number: int, source: FileSource) -> dict[str, Any]:
        return _listed(args, _tracked(args, source, calibrations[number]))

    first = args.sources[0]
    sources = open_two(first, second, strict=args.strict)
    with ending_on_interrupt(*sources):
        one, other = for_each(work, sources)
    for path, found in zip(paths, (one, other), strict=False):
        write_touches(path, found["touches"])
    since_us = one["t_first_us"]
    shown = _shown(one, first.name, since_us) + _shown(other, second.name, since_us)
    written = [f"written: {path}" for path in paths]
    return tell(args.json, one | {"second": other}, *shown, *written)


def _run_many(args: Args) -> int:

    if args.vibration:
        raise ConfigError("--vibration works on one recording at a time; name one")
    check = partial(load_config, args.preset)
    return run_many("touch", args, touch_one, ".csv", check, members=SERIES_MEMBERS)


def touch_one(args: Args, recording: Path, output: Path) -> dict[str, Any]:
    """List the touches of one of many recordings and return its row of the table."""
    found = _listed(args, _watch(args, recording))
    rows = found["touches"]
    write_touches(output, rows)
    return {
        "touches": len(rows),
        "touching_s": sum(row["duration_us"] or 0 for row in rows) / 1e6,
        "slips": sum(len(row["slips"] or []) for row in rows),
        "peak_strength_max": max((row["peak_strength"] for row in rows), default=0.0),
        "anomalies": sum(found["anomalies"].values()),
    }


def _shown(found: dict[str, Any], name: str, since_us: int | None) -> list[Table | str]:
    """Return what was found for a reader, with times from ``since_us`` on."""
    shown: list[Table | str] = [*counted(found["anomalies"])]
    if not found["touches"]:
        shown.append(f"note: no touch was found in {name}")
    shown.append(touch_table(name, found["touches"], since_us or 0))
    if found["vibration"] is not None:
        shown.append(vibration_table(name, found["vibration"], since_us or 0))
    return shown


def _listed(args: Args, watched: _Watched) -> dict[str, Any]:
    """Return the touches as rows, with what was wrong with the events."""
    config = TouchConfig.for_unit(watched.reference, watched.unit)
    detector = HeldTouchDetector(watched.reference, config)
    monitor = VibrationMonitor(watched.rate_hz, VIBRATION_WINDOW_S) if args.vibration else None
    found, lines, first_us, asked_us = [], [], None, 0
    for frame in watched.frames:
        if first_us is None:
            first_us = asked_us = frame.t_us
        if (held := detector.update(frame)) is not None:
            found.append(held)
        if monitor is None:
            continue
        monitor.update(frame.t_us, frame.detected_px - watched.reference)
        if frame.t_us - asked_us >= monitor.window_us:
            asked_us = frame.t_us
            spectrum = monitor.spectrum()
            if spectrum is not None and spectrum.line_hz is not None:
                lines.append(vibration_row(spectrum, watched.unit, watched.scale))
    if (last := detector.finish()) is not None:
        found.append(last)
    return {
        "t_first_us": first_us,
        "touches": [touch_row(one, watched.unit, watched.scale) for one in found],
        "anomalies": watched.anomalies,
        "health": watched.health or None,
        "vibration": None if monitor is None else lines,
    }


def _watch(args: Args, path: Path, advance: Advance = no_progress) -> _Watched:
    """Return the frames of a recording, of tracks, or of arrays."""
    if is_series(path):
        return _of_series(args, path)
    calibration = args.needed_calibration()
    source = open_events(path, strict=args.strict, sensor=args.sensor)
    return _tracked(args, source, calibration, advance)


def _tracked(
    args: Args, source: FileSource, calibration_path: Path, advance: Advance = no_progress
) -> _Watched:
    """Return the frames that a tracker makes of events."""
    calibration = Calibration.load(calibration_path)
    config = load_config(args.preset).with_tracking(rate_hz=args.rate_hz, hysteresis="none")
    require_same_size(source.size, calibration.size)
    tracker, rate_hz = make_tracker(config.tracking, calibration), config.tracking.rate_hz
    checked = CheckedSource(source, calibration, refuse if args.strict else warn)

    def frames() -> Iterator[MarkerFrame]:
        with ending_on_interrupt(source):
            for index, frame in enumerate(follow(checked, tracker, rate_hz, checked.losses)):
                if index % PROGRESS_EVERY == 0:
                    advance(source.progress)
                yield frame
        watched.anomalies.update(source.losses.kinds())
        watched.health.update(source.counters().summary())

    watched = _Watched(frames(), calibration.reference_px, "px", calibration.skin_scale, rate_hz)
    return watched


def _of_series(args: Args, path: Path) -> _Watched:
    """Return the frames of a series that was measured by another sensor, or of tracks."""
    series = load_series(path).in_image()

    def frames() -> Iterator[MarkerFrame]:
        markers = len(series.reference)
        seen, sure = np.zeros(markers, np.bool_), np.ones(markers)
        for t_us, moved in zip(series.t_us, series.displacement, strict=True):
            place = series.reference + moved
            yield MarkerFrame(int(t_us), place, place, moved, seen, sure)

    scale = SkinScale(1.0) if series.unit == "mm" else _scale_in_image(args, path)
    rate_hz = 1e6 / float(np.median(np.diff(series.t_us))) if len(series.t_us) > 1 else 1.0
    return _Watched(frames(), series.reference, series.unit, scale, rate_hz)


def _scale_in_image(args: Args, tracks: Path) -> SkinScale | None:
    """Return the scale of a calibration, or else the one that tracks keep; None without either."""
    if args.calibration is not None:
        return Calibration.load(args.calibration).skin_scale
    try:
        return Tracks.load(tracks).skin_scale
    except RecordingError:  # arrays alone, of another program
        return None
