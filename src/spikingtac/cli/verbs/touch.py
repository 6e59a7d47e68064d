"""``spikingtac touch``: list the touches in a recording: when, where, how large, how they hold."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro

import spikingtac as st
from spikingtac import events, touch
from spikingtac.batch.inputs import SERIES_MEMBERS
from spikingtac.batch.run import write_rows
from spikingtac.calibration.lens import SkinScale
from spikingtac.cli.messages import Advance, Table, counted
from spikingtac.cli.options import OF_EVENTS, Output, TrackerArgs
from spikingtac.cli.recordings import ManyArgs, SecondArgs, Work, run_each
from spikingtac.cli.sources import anomalies_of, checked, ending_on_interrupt, fitting
from spikingtac.file_kinds import kind_of

VIBRATION_WINDOW_S = 1.0  # Length of a spectrum of vibration, s: bins of 1 Hz.
PROGRESS_EVERY = 256  # Frames between two reports of progress.
UM_PER_MM = 1e3
TIMES = ("begin_us", "end_us", "duration_us", "peak_us")
SLIP = ("incipient_us", "gross_us", "end_us", "lead_us")  # Times of a slip, us.
WHOLE_FIELD = ("torsion_rad", "divergence", "curl", "strain")  # The same in px and in mm.
Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs, TrackerArgs, SecondArgs):
    """List the touches in a recording: begin, end, place, area, peak and slips of each.

    This verb tells touches apart and measures them, some 20 to 60 ms after they begin. To stop a
    robot within a millisecond, use: spikingtac contact.

    Of many recordings, the lists go into a folder, with a table of all results:
    spikingtac touch DAY --calibration C -o DAY_touches --workers 4

    Attributes:
        sources: Event file, recording folder or camera, with --calibration; or tracks.npz, or
            arrays t_us, reference_mm, displacement_mm. Several, folders of them, patterns such as
            'day/*.raw'.
        vibration: Report the strongest line of vibration in every second, from the markers' mean
            motion.
        output: CSV file to write, a line for each touch; a folder for many; touches_1.csv of
            --second.
    """

    sources: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SOURCE...")]
    vibration: bool = False
    output: Output = None


class Skin(NamedTuple):
    """What frames are read with.

    Attributes:
        reference: ``(m, 2)`` markers at rest, in ``unit``.
        unit: Unit of lengths, ``px`` or ``mm``.
        scale: From the unit to mm, None where it is not known.
        rate_hz: Frames per second.
    """

    reference: Any
    unit: str
    scale: SkinScale | None
    rate_hz: float


def run(args: Args) -> int:
    """Follow the markers, find the touches, and list them."""
    return run_each(WORK, args, args.sources, args.output)


def touch_one(
    args: Args, recording: Path | events.FileSource, output: Path | None, advance: Advance
) -> dict[str, Any]:
    """List the touches of a recording, of tracks, or of arrays; return them as rows."""
    if isinstance(recording, Path) and kind_of(recording) in ("tracks", "series"):
        args.refuse(f"is for events, and {recording.name} is tracks", *OF_EVENTS)
        found = _of_series(args, recording)
    else:
        found = _of_events(args, recording, advance)
    if output is not None:
        flat = [_flat(row) for row in found["touches"]]
        write_rows(output, list(flat[0]) if flat else TIMES, flat)
    return found


def check_many(args: Args) -> None:
    """Refuse what is wrong for all of many recordings."""
    if args.vibration:
        raise st.ConfigError("--vibration works on one recording at a time; name one")
    st.load_config(args.preset)


def touch_summary(found: dict[str, Any]) -> dict[str, Any]:
    """Return the row of one of many recordings."""
    rows = found["touches"]
    return {
        "touches": len(rows),
        "touching_s": sum(row["duration_us"] or 0 for row in rows) / 1e6,
        "slips": sum(len(row["slips"] or []) for row in rows),
        "peak_strength_max": max((row["peak_strength"] for row in rows), default=0.0),
        "anomalies": sum(found["anomalies"].values()),
    }


def touch_shown(found: dict[str, Any], name: str, first: dict[str, Any]) -> list[Table | str]:
    """Return what a reader sees, with times from the first finger's first event on."""
    since_us = first["t_first_us"] or 0
    shown: list[Table | str] = [*counted(found["anomalies"])]
    if not found["touches"]:
        shown.append(f"note: no touch was found in {name}")
    shown.append(_touch_table(name, found["touches"], since_us))
    if found["vibration"] is not None:
        shown.append(_vibration_table(name, found["vibration"], since_us))
    return shown


WORK = Work("touch", touch_one, touch_summary, touch_shown, (".csv",), check_many, SERIES_MEMBERS)


def _listed(args: Args, frames: Iterable[st.MarkerFrame], skin: Skin) -> dict[str, Any]:
    """Return the touches as rows."""
    detector = touch.HeldTouchDetector(skin.reference, skin.unit)
    monitor = touch.VibrationMonitor(skin.rate_hz, VIBRATION_WINDOW_S) if args.vibration else None
    found, lines, first_us, asked_us = [], [], None, 0
    for number, frame in enumerate(frames):
        if not number:
            first_us = asked_us = frame.t_us
        if (held := detector.update(frame)) is not None:
            found.append(held)
        if monitor is None:
            continue
        monitor.update(frame.t_us, frame.detected_px - skin.reference)
        if frame.t_us - asked_us >= monitor.window_us:
            asked_us, spectrum = frame.t_us, monitor.spectrum()
            if spectrum is not None and spectrum.line_hz is not None:
                lines.append(_vibration_row(spectrum, skin))
    found += [last] if (last := detector.finish()) is not None else []
    return {
        "t_first_us": first_us,
        "touches": [_touch_row(one, skin) for one in found],
        "anomalies": {},
        "health": None,
        "vibration": None if monitor is None else lines,
    }


def _of_events(args: Args, recording: Path | events.FileSource, advance: Advance) -> dict[str, Any]:
    """Return the touches in what a tracker makes of events."""
    source, path = args.open(recording), args.needed_calibration()
    calibration = fitting(path, source)
    config = st.load_config(args.preset).with_tracking(rate_hz=args.rate_hz, hysteresis="none")
    rate_hz, tracker = config.tracking.rate_hz, st.make_tracker(config.tracking, calibration)
    seen = checked(source, calibration, args.strict)

    def frames() -> Iterator[st.MarkerFrame]:
        for index, frame in enumerate(st.follow(seen, tracker, rate_hz, seen.losses)):
            if index % PROGRESS_EVERY == 0:
                advance(source.progress)
            yield frame

    skin = Skin(calibration.reference_px, "px", calibration.skin_scale, rate_hz)
    with ending_on_interrupt(source):
        found = _listed(args, frames(), skin)
    health = source.counters().summary() or None
    return found | {"anomalies": anomalies_of(source), "health": health}


def _of_series(args: Args, path: Path) -> dict[str, Any]:
    """Return the touches in tracks, or in a series that was measured by another sensor."""
    series = touch.load_series(path).in_image()
    seen, sure = np.zeros(len(series.reference), np.bool_), np.ones(len(series.reference))
    frames = (
        st.MarkerFrame(int(t_us), place := series.reference + moved, place, moved, seen, sure)
        for t_us, moved in zip(series.t_us, series.displacement, strict=True)
    )
    scale = SkinScale(1.0) if series.unit == "mm" else _scale_in_image(args, path)
    rate_hz = 1e6 / float(np.median(np.diff(series.t_us))) if len(series.t_us) > 1 else 1.0
    return _listed(args, frames, Skin(series.reference, series.unit, scale, rate_hz))


def _scale_in_image(args: Args, tracks: Path) -> SkinScale | None:
    """Return the scale of a calibration, or else the one that tracks keep; None without either."""
    if args.calibration is not None:
        return st.Calibration.load(args.calibration).skin_scale
    try:
        return st.Tracks.load(tracks).skin_scale
    except st.RecordingError:  # arrays alone, of another program
        return None


def _touch_row(held: st.HeldTouch, skin: Skin) -> Row:
    """Return a touch as plain values: in px, and in mm where the scale is known."""
    found, field = held.touch, held.touch.field
    row: Row = {name: getattr(found, name) for name in TIMES}
    row["peak_strength"] = round(found.peak_strength, 6)
    told, scales = {}, {"px": SkinScale(1.0)} if skin.unit == "px" else {}
    for name, scale in (scales | ({"mm": skin.scale} if skin.scale else {})).items():
        local = scale.mm_per_px(found.place_px)
        row |= {
            f"place_{name}": scale.to_mm(found.place_px).round(4).tolist(),
            f"area_{name}2": round(found.area_px2 * local**2, 4),
            f"peak_displacement_{name}": round(found.peak_displacement_px * local, 5),
            f"outline_{name}": scale.to_mm(found.outline_px).round(3).tolist(),
        }
        told[f"mean_shear_x_{name}"] = field.mean_shear_x_px.times(local)
        told[f"mean_shear_y_{name}"] = field.mean_shear_y_px.times(local)
    row["slips"] = held.slips and [
        {name: getattr(slip, name) for name in SLIP}
        | {"least_sticking_share": round(slip.least_sticking_share, 3)}
        for slip in held.slips
    ]
    row["field"] = {}
    for name, one in (told | {name: getattr(field, name) for name in WHOLE_FIELD}).items():
        row["field"] |= {name: round(one.value, 6), f"{name}_std": round(one.sigma, 6)}
    return row


def _flat(row: Row) -> Row:
    out: Row = {}
    for key, value in row.items():
        if key.startswith("place_"):
            out[key.replace("_", "_x_")], out[key.replace("_", "_y_")] = value
        elif key == "slips":
            out |= {"slips": None if value is None else len(value)} | _first_slip(value)
        elif key != "field" and not key.startswith("outline_"):
            out[key] = value
    return out | row["field"]


def _first_slip(slips: list[Row] | None) -> Row:
    """Return the time of the first slip of each kind; None where there is none."""
    times = {name: [slip[name] for slip in slips or ()] for name in SLIP[:2]}
    return {name: min((t for t in of if t is not None), default=None) for name, of in times.items()}


def _touch_table(name: str, rows: list[Row], first_us: int) -> Table:
    """Return the touches of a recording for a reader, times from ``first_us`` on."""
    unit = "mm" if rows and "place_mm" in rows[0] else "px"
    columns = ("begin ms", "end ms", f"place {unit}", f"area {unit}2", f"displacement {unit}",
               "peak strain", "slip ms")  # fmt: skip
    shown = []
    for row in rows:
        times_us = [row["begin_us"], row["end_us"]]
        times = ["-" if t is None else f"{(t - first_us) / 1e3:.0f}" for t in times_us]
        place, area = "{:.1f}, {:.1f}".format(*row[f"place_{unit}"]), row[f"area_{unit}2"]
        figures = f"{row[f'peak_displacement_{unit}']:.2f}", f"{row['peak_strength']:.3f}"
        shown.append((*times, place, f"{area:.1f}", *figures, _slip_text(row["slips"], first_us)))
    return Table(f"touches in {name}, times from its first event", columns, shown, words=0)


def _slip_text(slips: list[Row] | None, first_us: int) -> str:
    """Return what slipped first, and when, ms from ``first_us``."""
    first = _first_slip(slips)
    told = [
        f"{what} from {(first[name] - first_us) / 1e3:.0f}"
        for what, name in (("all", "gross_us"), ("part", "incipient_us"))
        if first[name] is not None
    ]
    return "unknown" if slips is None else (told or ["none"])[0]


def _vibration_row(found: touch.Spectrum, skin: Skin) -> Row:
    """Return a line of vibration as plain values: in px, and in um where the scale is known."""
    row: Row = {
        "t_us": found.t_us,
        "line_hz": round(found.line_hz or 0.0, 3),
        "noise_ratio": round(found.line_px / found.noise_px, 2),
    }
    scales = {"px": (1.0, 5)} if skin.unit == "px" else {}
    scales |= {} if skin.scale is None else {"um": (UM_PER_MM / skin.scale.px_per_mm, 3)}
    for name, (scale, digits) in scales.items():
        row[f"amplitude_{name}"] = round(scale * found.line_px, digits)
        row[f"sigma_{name}"] = round(scale * found.noise_px, digits)
    return row


def _vibration_table(name: str, lines: list[Row], first_us: int) -> Table:
    """Return lines of vibration for a reader, times from ``first_us`` on."""
    unit = "um" if lines and "amplitude_um" in lines[0] else "px"
    shown = [
        (
            f"{(row['t_us'] - first_us) / 1e3:.0f}",
            f"{row['line_hz']:.1f}",
            f"{row['noise_ratio']:.0f}",
            f"{row[f'amplitude_{unit}']:.3g} +- {row[f'sigma_{unit}']:.2g}",
        )
        for row in lines
    ]
    columns = ("until ms", "line Hz", "over noise", f"amplitude {unit}")
    return Table(f"vibration in {name}, the second before each time", columns, shown, words=0)
