"""``spikingtac touch``: list the touches in a recording: when, where, how large, how they hold."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro

import spikingtac as st
from spikingtac import events, touch
from spikingtac.batch.inputs import SERIES_MEMBERS
from spikingtac.calibration.lens import SkinScale
from spikingtac.cli.messages import Advance, Table, counted
from spikingtac.cli.options import Output, TrackerArgs
from spikingtac.cli.recordings import ManyArgs, SecondArgs, Work, run_each
from spikingtac.cli.sources import checked, ending_on_interrupt, fitting
from spikingtac.cli.verbs.touch_rows import (
    touch_row,
    touch_table,
    vibration_row,
    vibration_table,
    write_touches,
)
from spikingtac.file_kinds import kind_of

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
    """CSV file to write, a line for each touch; a folder for many; touches_1.csv of --second."""


class Skin(NamedTuple):
    """What frames are read with; lengths are in ``unit``."""

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
        found = _of_series(args, recording)
    else:
        found = _of_events(args, recording, advance)
    if output is not None:
        write_touches(output, found["touches"])
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
    shown.append(touch_table(name, found["touches"], since_us))
    if found["vibration"] is not None:
        shown.append(vibration_table(name, found["vibration"], since_us))
    return shown


WORK = Work("touch", touch_one, touch_summary, touch_shown, ".csv", check_many, SERIES_MEMBERS)


def _listed(args: Args, frames: Iterable[st.MarkerFrame], skin: Skin) -> dict[str, Any]:
    """Return the touches as rows."""
    detector = touch.HeldTouchDetector(
        skin.reference, touch.TouchConfig.for_unit(skin.reference, skin.unit)
    )
    monitor = touch.VibrationMonitor(skin.rate_hz, VIBRATION_WINDOW_S) if args.vibration else None
    found, lines, first_us, asked_us = [], [], None, 0
    for frame in frames:
        if first_us is None:
            first_us = asked_us = frame.t_us
        if (held := detector.update(frame)) is not None:
            found.append(held)
        if monitor is None:
            continue
        monitor.update(frame.t_us, frame.detected_px - skin.reference)
        if frame.t_us - asked_us >= monitor.window_us:
            asked_us, spectrum = frame.t_us, monitor.spectrum()
            if spectrum is not None and spectrum.line_hz is not None:
                lines.append(vibration_row(spectrum, skin.unit, skin.scale))
    found += [last] if (last := detector.finish()) is not None else []
    return {
        "t_first_us": first_us,
        "touches": [touch_row(one, skin.unit, skin.scale) for one in found],
        "anomalies": {},
        "health": None,
        "vibration": None if monitor is None else lines,
    }


def _of_events(args: Args, recording: Path | events.FileSource, advance: Advance) -> dict[str, Any]:
    """Return the touches in what a tracker makes of events."""
    path, source = args.needed_calibration(), args.open(recording)
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
    anomalies, health = dict(source.losses.kinds()), source.counters().summary()
    return found | {"anomalies": anomalies, "health": health or None}


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
