"""``spikingtac touch``: list the touches in a recording: when, where, how large, how they hold."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.atomic_files import require_free
from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.messages import emit_json, emit_table, progress, remark
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.touch.slip.held_touches import HeldTouch
    from spikingtac.touch.slip.slip import Slip
    from spikingtac.touch.touches.touch import Touch
    from spikingtac.touch.touches.touch_config import TouchConfig
    from spikingtac.types import MarkerFrame


@dataclass(frozen=True, kw_only=True)
class Args:
    """List the touches in a recording: begin, end, place, area, peak and slips of each.

    This verb tells touches apart and measures them, some ten milliseconds after they happen. To
    stop a robot within a millisecond, use: spikingtac contact.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """Event file, recording folder or camera, with --calibration; or tracks.npz, or arrays t_us,
    reference_mm, displacement_mm."""
    calibration: Path | None = None
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """CSV file to write, one line per touch."""
    preset: str = "default"
    """Tracker: default, fast or paper, or a TOML file."""
    rate_hz: float | None = None
    """Estimates per second; the preset's unless given."""
    sensor: int = 0
    """In a folder, the sensor to read: 1 reads events_1.raw."""
    strict: bool = False
    """Refuse a damaged recording instead of repairing it."""
    overwrite: bool = False
    """Replace a file that is there."""
    json: bool = False
    """Print one JSON object on stdout."""


@dataclass(frozen=True, slots=True)
class _Watched:
    """Frames with what is needed to read them; lengths are in ``unit``."""

    frames: Iterator[MarkerFrame]
    reference: Any
    unit: str
    px_per_mm: float | None
    anomalies: dict[str, int]


def run(args: Args) -> int:
    """Follow the markers, find the touches, and list them."""
    from spikingtac.touch.slip.held_touches import HeldTouchDetector

    if args.output is not None:
        require_free(args.output, args.overwrite)
    with progress(f"watching {args.source.name}") as advance:
        watched = _watch(args, advance)
        detector = HeldTouchDetector(watched.reference, _config(watched))
        found, first_us = [], None
        for frame in watched.frames:
            first_us = frame.t_us if first_us is None else first_us
            held = detector.update(frame)
            if held is not None:
                found.append(held)
    last = detector.finish()
    found += [last] if last is not None else []
    rows = [_row(held, watched) for held in found]
    if args.output is not None:
        _write(args.output, rows)
    if args.json:
        emit_json({"t_first_us": first_us, "touches": rows, "anomalies": watched.anomalies})
    else:
        _print(rows, args, watched, first_us or 0)
    return 0


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


def _watch(args: Args, advance: Any) -> _Watched:
    from spikingtac.touch.force.files.series_file import is_series, load_series

    if is_series(args.source):
        series = load_series(args.source).in_image()
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
    return _track(args, advance)


def _track(args: Args, advance: Any) -> _Watched:
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.config import load_config
    from spikingtac.events.open import open_events
    from spikingtac.markers.registry import make_tracker
    from spikingtac.pipeline.follow import follow
    from spikingtac.pipeline.recording_tracks import require_same_size

    assert args.calibration is not None  # _watch() has asked for it
    calibration = Calibration.load(args.calibration)
    config = load_config(args.preset).with_tracking(rate_hz=args.rate_hz, hysteresis="none")
    source = open_events(args.source, strict=args.strict, sensor=args.sensor)
    require_same_size(source.size, calibration.size)
    tracker = make_tracker(config.tracking, calibration)
    anomalies: dict[str, int] = {}

    def frames() -> Iterator[MarkerFrame]:
        with ending_on_interrupt(source):
            for index, frame in enumerate(follow(source, tracker, config.tracking.rate_hz)):
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


def _row(held: HeldTouch, watched: _Watched) -> dict[str, Any]:
    """Return a touch as plain values: in px, and in mm where the scale is known."""
    touch = held.touch
    row: dict[str, Any] = {
        "begin_us": touch.begin_us,
        "end_us": touch.end_us,
        "duration_us": touch.duration_us,
        "peak_us": touch.peak_us,
        "peak_strength": round(touch.peak_strength, 6),
    }
    if watched.unit == "px":
        row |= _lengths(touch, "px", 1.0)
    if watched.px_per_mm is not None:
        row |= _lengths(touch, "mm", watched.px_per_mm)
    return row | {"slips": None if held.slips is None else [_slip(slip) for slip in held.slips]}


def _slip(slip: Slip) -> dict[str, Any]:
    return {
        "incipient_us": slip.incipient_us,
        "gross_us": slip.gross_us,
        "end_us": slip.end_us,
        "lead_us": slip.lead_us,
        "least_sticking_share": round(slip.least_sticking_share, 3),
    }


def _lengths(touch: Touch, unit: str, scale: float) -> dict[str, Any]:
    return {
        f"place_{unit}": (touch.place_px / scale).round(4).tolist(),
        f"area_{unit}2": round(touch.area_px2 / scale**2, 4),
        f"peak_displacement_{unit}": round(touch.peak_displacement_px / scale, 5),
        f"outline_{unit}": (touch.outline_px / scale).round(3).tolist(),
    }


def _write(path: Path, rows: list[dict[str, Any]]) -> None:
    flat = [_flat(row) for row in rows]
    columns = list(flat[0]) if flat else ["begin_us", "end_us", "duration_us", "peak_us"]
    beside = path.with_name(path.name + ".part")
    try:
        with beside.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(flat)
        beside.replace(path)
    except OSError as error:
        raise ConfigError(f"cannot write {str(path)!r}: {error.strerror}") from error


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in row.items():
        if key.startswith("place_"):
            unit = key.removeprefix("place_")
            out[f"place_x_{unit}"], out[f"place_y_{unit}"] = value
        elif key == "slips":
            out |= _first_slip(value)
        elif not key.startswith("outline_"):
            out[key] = value
    return out


def _first_slip(slips: list[dict[str, Any]] | None) -> dict[str, Any]:
    """Return how many slips a touch had, and the first of each kind; nothing where none is told."""
    told = slips or []
    incipient = [slip["incipient_us"] for slip in told if slip["incipient_us"] is not None]
    gross = [slip["gross_us"] for slip in told if slip["gross_us"] is not None]
    return {
        "slips": None if slips is None else len(slips),
        "incipient_us": min(incipient, default=None),
        "gross_us": min(gross, default=None),
    }


def _slip_text(slips: list[dict[str, Any]] | None, first_us: int) -> str:
    first = _first_slip(slips)
    if first["slips"] is None:
        return "not told"
    if first["gross_us"] is not None:
        return f"all from {(first['gross_us'] - first_us) / 1e3:.0f}"
    if first["incipient_us"] is not None:
        return f"part from {(first['incipient_us'] - first_us) / 1e3:.0f}"
    return "none"


def _print(rows: list[dict[str, Any]], args: Args, watched: _Watched, first_us: int) -> None:
    for kind, count in watched.anomalies.items():
        remark(f"note: {kind} {count} times in the recording")
    unit = "mm" if watched.px_per_mm is not None else "px"
    emit_table(
        f"touches in {args.source.name}, times from its first event",
        (
            "begin ms",
            "end ms",
            f"place {unit}",
            f"area {unit}2",
            f"peak {unit}",
            "peak strain",
            "slip ms",
        ),
        [
            (
                f"{(row['begin_us'] - first_us) / 1e3:.0f}",
                "-" if row["end_us"] is None else f"{(row['end_us'] - first_us) / 1e3:.0f}",
                "{:.1f}, {:.1f}".format(*row[f"place_{unit}"]),
                f"{row[f'area_{unit}2']:.1f}",
                f"{row[f'peak_displacement_{unit}']:.2f}",
                f"{row['peak_strength']:.3f}",
                _slip_text(row["slips"], first_us),
            )
            for row in rows
        ],
        words=0,
    )
