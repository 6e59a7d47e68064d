"""``spikingtac touch``: list the touches in a recording: when, where, how large, how they hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.calibration.lens import SkinScale
from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.many import ManyArgs, means_many, run_many
from spikingtac.cli.messages import Table, progress, tell, warn
from spikingtac.cli.options import Output, TrackerArgs
from spikingtac.cli.second import SecondArgs, second_name, work_on_two
from spikingtac.cli.verbs.touch_rows import (
    touch_row,
    touch_table,
    vibration_row,
    vibration_table,
    write_rows,
)
from spikingtac.errors import ConfigError, RecordingError

if TYPE_CHECKING:
    from spikingtac.events.formats.file_source import FileSource
    from spikingtac.touch.force.series import WrenchSeries
    from spikingtac.types import MarkerFrame

VIBRATION_WINDOW_S = 1.0  # Length of a spectrum of vibration, s: bins of 1 Hz.
PROGRESS_EVERY = 256  # Frames between two reports of progress.


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs, TrackerArgs, SecondArgs):
    """List the touches in a recording: begin, end, place, area, peak and slips of each.

    This verb tells touches apart and measures them, some 20 to 60 ms after they begin. To stop a
    robot within a millisecond, use: spikingtac contact.

    Of many recordings, the lists go into a folder, with a table of all results and a report:
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
    anomalies: dict[str, int]
    health: dict[str, float]


@dataclass(frozen=True, slots=True)
class _Found:
    """The touches of a recording as rows, and where they are from."""

    rows: list[dict[str, Any]]
    first_us: int | None
    watched: _Watched
    lines: list[dict[str, Any]] | None

    @property
    def document(self) -> dict[str, Any]:
        watched = self.watched
        return {
            "t_first_us": self.first_us,
            "touches": self.rows,
            "anomalies": watched.anomalies,
            "health": watched.health or None,
            "vibration": self.lines,
        }

    def shown(self, name: str, since_us: int | None) -> list[Table | str]:
        """Return the same for a reader, with times from ``since_us`` on."""
        anomalies = self.watched.anomalies.items()
        notes = [f"note: {kind} {count} times in the recording" for kind, count in anomalies]
        px_per_mm = None if self.watched.scale is None else self.watched.scale.px_per_mm
        if not self.rows:
            notes.append(f"note: no touch was found in {name}")
        tables = [touch_table(name, self.rows, px_per_mm, since_us or 0)]
        if self.lines is not None:
            tables.append(vibration_table(name, self.lines, px_per_mm, since_us or 0))
        return [*notes, *tables]


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
    shown = found.shown(source.name, found.first_us)
    if args.output is not None:
        write_rows(args.output, found.rows)
        shown.append(f"written: {args.output}")
    return tell(args.json, found.document, *shown)


def _run_two(args: Args, second: Path, many: bool) -> int:
    """List the touches of two fingers on the first one's clock."""
    calibrations = args.calibrations(args.calibration, many)
    paths = [] if args.output is None else [args.output, second_name(args.output)]
    args.claim(*paths)

    def work(number: int, source: FileSource) -> _Found:
        return _listed(args, _track(args, source, calibrations[number]))

    one, other = work_on_two(args.sources[0], second, args.strict, work)
    for path, found in zip(paths, (one, other), strict=False):
        write_rows(path, found.rows)
    shown = one.shown(args.sources[0].name, one.first_us) + other.shown(second.name, one.first_us)
    written = [f"written: {path}" for path in paths]
    return tell(args.json, one.document | {"second": other.document}, *shown, *written)


def _run_many(args: Args) -> int:
    from spikingtac.batch.inputs import SERIES_MEMBERS
    from spikingtac.config import load_config

    if args.vibration:
        raise ConfigError("--vibration works on one recording at a time; name one")
    check, members = partial(load_config, args.preset), SERIES_MEMBERS
    return run_many("touch", args, touch_one, ".csv", check, members=members)


def touch_one(args: Args, recording: Path, output: Path) -> dict[str, Any]:
    """List the touches of one of many recordings and return its row of the table."""
    found = _listed(args, _watch(args, recording))
    write_rows(output, found.rows)
    ended = [row["duration_us"] for row in found.rows if row["duration_us"] is not None]
    return {
        "touches": len(found.rows),
        "touching_s": sum(ended) / 1e6,
        "slips": sum(len(row["slips"] or []) for row in found.rows),
        "peak_strength_max": max((row["peak_strength"] for row in found.rows), default=0.0),
        "anomalies": sum(found.watched.anomalies.values()),
    }


def _listed(args: Args, watched: _Watched) -> _Found:
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
                lines.append(vibration_row(spectrum, watched.unit, watched.scale))
    last = detector.finish()
    found += [] if last is None else [last]
    rows = [touch_row(held, watched.unit, watched.scale) for held in found]
    return _Found(rows, first_us, watched, None if monitor is None else lines)


def _watch(
    args: Args, path: Path, advance: Callable[[float], None] = lambda share: None
) -> _Watched:
    """Return the frames of a recording, of tracks, or of arrays; ``advance`` is told the share."""
    from spikingtac.touch.force.series import is_series, load_series

    if is_series(path):
        return _watched_series(args, path, load_series(path).in_image())
    if args.calibration is None:
        raise ConfigError(
            "events need the sensor's calibration: --calibration calibration.json; "
            "make one with: spikingtac calibrate RECORDING -o calibration.json"
        )
    from spikingtac.events.open import open_events

    source = open_events(path, strict=args.strict, sensor=args.sensor)
    return _track(args, source, args.calibration, advance)


def _track(
    args: Args,
    source: FileSource,
    calibration_path: Path,
    advance: Callable[[float], None] = lambda share: None,
) -> _Watched:
    """Return the frames that a tracker makes of events."""
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.config import load_config
    from spikingtac.markers.registry import make_tracker
    from spikingtac.pipeline.checked_source import CheckedSource, refuse
    from spikingtac.pipeline.follow import follow
    from spikingtac.pipeline.track import require_same_size

    calibration = Calibration.load(calibration_path)
    config = load_config(args.preset).with_tracking(rate_hz=args.rate_hz, hysteresis="none")
    require_same_size(source.size, calibration.size)
    tracker, rate_hz = make_tracker(config.tracking, calibration), config.tracking.rate_hz
    checked = CheckedSource(source, calibration, refuse if args.strict else warn)
    anomalies: dict[str, int] = {}
    health: dict[str, float] = {}

    def frames() -> Iterator[MarkerFrame]:
        with ending_on_interrupt(source):
            for index, frame in enumerate(follow(checked, tracker, rate_hz, checked.losses)):
                if index % PROGRESS_EVERY == 0:
                    advance(source.progress)
                yield frame
        anomalies.update(source.losses.kinds())
        health.update(source.counters().summary())

    told = (rate_hz, anomalies, health)
    return _Watched(frames(), calibration.reference_px, "px", calibration.skin_scale, *told)


def _watched_series(args: Args, path: Path, series: WrenchSeries) -> _Watched:
    """Return the frames of a series that was measured by another sensor, or of tracks."""
    import numpy as np

    from spikingtac.types import MarkerFrame

    def frames() -> Iterator[MarkerFrame]:
        markers = len(series.reference)
        seen, sure = np.zeros(markers, np.bool_), np.ones(markers)
        for t_us, moved in zip(series.t_us, series.displacement, strict=True):
            place = series.reference + moved
            yield MarkerFrame(int(t_us), place, place, moved, seen, sure)

    scale = SkinScale(1.0) if series.unit == "mm" else _scale_in_image(args, path)
    rate_hz = 1e6 / float(np.median(np.diff(series.t_us))) if len(series.t_us) > 1 else 1.0
    return _Watched(frames(), series.reference, series.unit, scale, rate_hz, {}, {})


def _scale_in_image(args: Args, tracks: Path) -> SkinScale | None:
    """Return the scale of a calibration, or else the one that tracks keep; None without either."""
    if args.calibration is not None:
        from spikingtac.calibration.sensor_calibration import Calibration

        return Calibration.load(args.calibration).skin_scale
    from spikingtac.tracks.tracks import Tracks

    try:
        return Tracks.load(tracks).skin_scale
    except RecordingError:  # arrays alone, of another program
        return None
