"""``spikingtac touch``: list the touches in a recording: when, where, how large, how they hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.atomic_files import require_free
from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.many import ManyArgs, means_many, require_folder, run_many
from spikingtac.cli.messages import emit_json, emit_table, progress, remark, warn
from spikingtac.cli.sensing.touch_rows import slip_text, touch_row, write_rows
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.touch.touches.touch_config import TouchConfig
    from spikingtac.types import MarkerFrame

WORK = "spikingtac.cli.sensing.touch:touch_one"
"""What a worker calls for each of many recordings."""


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs):
    """List the touches in a recording: begin, end, place, area, peak and slips of each.

    This verb tells touches apart and measures them, some ten milliseconds after they happen. To
    stop a robot within a millisecond, use: spikingtac contact.

    Of many recordings, the lists go into a folder, with a table of all results and a report:
    spikingtac touch DAY --calibration C -o DAY_touches --workers 4
    """

    sources: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SOURCE...")]
    """Event file, recording folder or camera, with --calibration; or tracks.npz, or arrays t_us,
    reference_mm, displacement_mm. Several, folders of them, patterns such as 'day/*.raw'."""
    calibration: Path | None = None
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """CSV file to write, one line per touch; a folder for many."""
    preset: str = "default"
    """Tracker: default, fast or paper, or a TOML file."""
    rate_hz: float | None = None
    """Estimates per second; the preset's unless given."""
    sensor: int = 0
    """In a folder, the sensor to read: 1 reads events_1.raw."""
    strict: bool = False
    """Refuse a damaged recording instead of repairing it."""


@dataclass(frozen=True, slots=True)
class _Watched:
    """Frames with what is needed to read them; lengths are in ``unit``."""

    frames: Iterator[MarkerFrame]
    reference: Any
    unit: str
    px_per_mm: float | None
    anomalies: dict[str, int]


@dataclass(frozen=True, slots=True)
class _Found:
    """The touches of a recording as rows, and where they are from."""

    rows: list[dict[str, Any]]
    first_us: int | None
    watched: _Watched


def run(args: Args) -> int:
    """Follow the markers, find the touches, and list them."""
    if means_many(args, args.sources):
        return _run_many(args)
    source = args.sources[0]
    if args.output is not None:
        require_free(args.output, args.overwrite)
    with progress(f"watching {source.name}") as advance:
        found = _find(args, source, advance)
    if args.output is not None:
        write_rows(args.output, found.rows)
    if args.json:
        anomalies = found.watched.anomalies
        emit_json({"t_first_us": found.first_us, "touches": found.rows, "anomalies": anomalies})
    else:
        _print(found, source)
    return 0


def _run_many(args: Args) -> int:
    from spikingtac.batch.inputs import SERIES_MEMBERS, find_recordings
    from spikingtac.batch.run import Batch
    from spikingtac.config import load_config

    folder = require_folder(args.output, "touch")
    load_config(args.preset)  # what is wrong for all of them is refused before any work is done
    preset = Path(args.preset)
    batch = Batch(
        name="touch",
        work=WORK,
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
    from spikingtac.touch.slip.held_touches import HeldTouchDetector

    watched = _watch(args, source, advance)
    detector = HeldTouchDetector(watched.reference, _config(watched))
    found, first_us = [], None
    for frame in watched.frames:
        first_us = frame.t_us if first_us is None else first_us
        held = detector.update(frame)
        if held is not None:
            found.append(held)
    last = detector.finish()
    found += [last] if last is not None else []
    return _Found(
        [touch_row(held, watched.unit, watched.px_per_mm) for held in found], first_us, watched
    )


SCATTER_SHARE = 0.03
"""Scatter of markers of another sensor, as a share of their pitch (ours: 0.045 mm of 1.6 mm on a
published series at rest)."""


def _config(watched: _Watched) -> TouchConfig:
    """Return the settings: those of events, or of places from a sensor that sees no changes."""
    import numpy as np

    from spikingtac.touch.touches.backlash import NOTHING_UNSEEN
    from spikingtac.touch.touches.touch_config import TouchConfig

    if watched.unit == "px":
        return TouchConfig()
    away = ((watched.reference[:, None] - watched.reference[None]) ** 2).sum(axis=2)
    np.fill_diagonal(away, np.inf)
    pitch = float(np.sqrt(np.median(away.min(axis=1))))
    return TouchConfig(least_displacement_px=SCATTER_SHARE * pitch, unseen=NOTHING_UNSEEN)


def _watch(args: Args, path: Path, advance: Any) -> _Watched:
    from spikingtac.touch.force.files.series_file import is_series, load_series

    if is_series(path):
        series = load_series(path).in_image()
        scale = _px_per_mm(args)
        return _Watched(
            _frames(series),
            series.reference,
            series.unit,
            scale if series.unit == "px" else 1.0,
            {},
        )
    if args.calibration is None:
        raise ConfigError(
            "events need the sensor's calibration: --calibration calibration.json; "
            "make one with: spikingtac calibrate RECORDING -o calibration.json"
        )
    return _track(args, path, advance)


def _track(args: Args, path: Path, advance: Any) -> _Watched:
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.config import load_config
    from spikingtac.events.open import open_events
    from spikingtac.markers.registry import make_tracker
    from spikingtac.pipeline.checked_source import CheckedSource, refuse
    from spikingtac.pipeline.follow import follow
    from spikingtac.pipeline.recording_tracks import require_same_size

    assert args.calibration is not None  # _watch() has asked for it
    calibration = Calibration.load(args.calibration)
    config = load_config(args.preset).with_tracking(rate_hz=args.rate_hz, hysteresis="none")
    source = open_events(path, strict=args.strict, sensor=args.sensor)
    require_same_size(source.size, calibration.size)
    tracker = make_tracker(config.tracking, calibration)
    checked = CheckedSource(source, calibration, refuse if args.strict else warn)
    anomalies: dict[str, int] = {}

    def frames() -> Iterator[MarkerFrame]:
        with ending_on_interrupt(source):
            for index, frame in enumerate(follow(checked, tracker, config.tracking.rate_hz)):
                if index % PROGRESS_EVERY == 0:
                    advance(source.progress)
                yield frame
        anomalies.update(source.losses.kinds())

    return _Watched(frames(), calibration.reference_px, "px", calibration.px_per_mm, anomalies)


PROGRESS_EVERY = 256
"""Frames between two reports of progress."""


def _px_per_mm(args: Args) -> float | None:
    if args.calibration is None:
        return None
    from spikingtac.calibration.sensor_calibration import Calibration

    return Calibration.load(args.calibration).px_per_mm


def _frames(series: Any) -> Iterator[MarkerFrame]:
    import numpy as np

    from spikingtac.types import MarkerFrame

    markers = len(series.reference)
    for t_us, moved in zip(series.t_us, series.displacement, strict=True):
        place = series.reference + moved
        seen, sure = np.zeros(markers, np.bool_), np.ones(markers)
        yield MarkerFrame(int(t_us), place, place, moved, seen, sure)


def _print(found: _Found, source: Path) -> None:
    rows, watched, first_us = found.rows, found.watched, found.first_us or 0
    for kind, count in watched.anomalies.items():
        remark(f"note: {kind} {count} times in the recording")
    unit = "mm" if watched.px_per_mm is not None else "px"
    emit_table(
        f"touches in {source.name}, times from its first event",
        (
            *("begin ms", "end ms", f"place {unit}", f"area {unit}2", f"peak {unit}"),
            *("peak strain", "slip ms"),
        ),
        [
            (
                f"{(row['begin_us'] - first_us) / 1e3:.0f}",
                "-" if row["end_us"] is None else f"{(row['end_us'] - first_us) / 1e3:.0f}",
                "{:.1f}, {:.1f}".format(*row[f"place_{unit}"]),
                f"{row[f'area_{unit}2']:.1f}",
                f"{row[f'peak_displacement_{unit}']:.2f}",
                f"{row['peak_strength']:.3f}",
                slip_text(row["slips"], first_us),
            )
            for row in rows
        ],
        words=0,
    )
