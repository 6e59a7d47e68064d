"""``spikingtac calibrate``: learn where the markers rest and how they look; check recordings."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median_high
from typing import Annotated, Any, Literal

import tyro

import spikingtac as st
from spikingtac import events
from spikingtac.atomic_files import require_free, write_json
from spikingtac.calibration.document import OWN
from spikingtac.cli import messages
from spikingtac.cli.messages import Advance, Table, figures, no_progress, progress, remark, tell
from spikingtac.cli.options import whole_numbers
from spikingtac.cli.recordings import ManyArgs, Work, means_many, run_many, the_only_one
from spikingtac.cli.sources import anomalies_of, ending_on_interrupt, fitting
from spikingtac.file_kinds import kind_of
from spikingtac.markers.calibration.lattice import LayoutKind
from spikingtac.markers.calibration.reference import Method
from spikingtac.plots.circles import save_calibration_plot
from spikingtac.plots.figure import PICTURE_ENDINGS
from spikingtac.types import Polarity

TELL_US = 2_000_000  # Sensor time between two reports of what a calibration lacks, us.
TOO_STILL = "too little moves to tell whether it fits; touch the skin in many places"
ENDINGS = (".json",)  # Of what is written.
MOST_NAMED = 8  # Stray spots that are named one by one.

# Figures of a calibration, and of its notes, that are told as they are.
TOLD = ("polarity", *OWN, "lag_us", "dead_time_us", "px_per_mm")
NOTED = ("missing", "doubtful", "explained", "events", "residual", "scatter_px")

# Options that mean nothing where the scale of a calibration is set, or one is checked.
OF_RECORDINGS = ("grid", "layout", "lens", "polarity", "method", "allow_missing", "plot",
                 "until_ready")  # fmt: skip
UNUSUAL = ("no_lens", "left_out_px", "stray_px", "coarse_steps", "flicker_hz", "event_loss")


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs):
    """Learn where the markers rest, how large they are and what an event stands for.

    Any recording will do in which the markers move: presses, contacts or slides. It is best when
    it begins without load, when every marker moves by more than its diameter, and when the skin
    rests for half a second between contacts.

    A calibration.json in the place of the recording, with --pitch-mm: set its scale afterwards.
    With --check, whether recordings come from the sensor of a calibration; many go into a folder:
    spikingtac calibrate --check left_finger.json DAY -o DAY_checked --workers 4

    Attributes:
        recordings: Event file, recording folder, or a camera: its address, a named pipe, or -; or a
            calibration, to set its scale. With --check also several, a folder of recordings or a
            pattern such as 'day/*.raw'.
        check: Write no calibration: say whether the recordings fit this one.
        output: File to write; with --check the folder for many.
        grid: Size of the grid, as 8x8; found by itself unless given.
        layout: Rows and columns, every second row shifted, or no rows; auto tells the first two
            apart.
        pitch_mm: Distance of neighbouring markers on the skin, mm; gives px_per_mm.
        lens: With --pitch-mm, on a flat skin: fit the lens's distortion and the camera's tilt.
        polarity: White markers on dark ground, or dark on light; found by itself unless given.
        method: How the reference is computed from the rests; bounding-box is the published one.
        allow_missing: Largest number of missing markers, which the others place; a third unless
            given.
        plot: Picture to write: the markers as circles, good and doubtful ones in different colours.
        until_ready: End a camera by itself once every marker has moved enough and the skin rests.
    """

    recordings: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RECORDING")
    ]
    check: Annotated[Path | None, tyro.conf.arg(metavar="CALIBRATION")] = None
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("calibration.json")
    grid: Annotated[tuple[int, int] | None, whole_numbers(2, "ROWSxCOLUMNS")] = None
    layout: LayoutKind = "auto"
    pitch_mm: float | None = None
    lens: bool = False
    polarity: Literal["auto"] | Polarity = "auto"
    method: Method = "rest-mean"
    allow_missing: int | None = None
    plot: Path | None = None
    until_ready: bool = False


def run(args: Args) -> int:
    """Calibrate, write the file, and say what was found; or check."""
    if args.check is not None:
        return _check(args, args.check)
    if means_many(args, args.recordings):
        raise st.ConfigError(
            "calibrate learns from one recording; to check many against a calibration: "
            "spikingtac calibrate --check calibration.json DAY -o DAY_checked"
            f"{the_only_one(args.recordings)}"
        )
    recording = args.recordings[0]
    if kind_of(recording) == "calibration":
        return _set_scale(args, recording)
    args.claim(args.output, endings=ENDINGS)
    args.claim(args.plot, endings=PICTURE_ENDINGS)
    same = ("grid", "pitch_mm", "lens", "polarity", "layout", "method", "allow_missing")
    given = {name: getattr(args, name) for name in same}
    config = st.CalibrationConfig(**given)
    source = args.open(recording)
    seen: st.EventSource = source
    if args.until_ready or events.is_stream(recording):
        seen = st.PacketSource(_guided(source, config, args.until_ready), source.size)
    with ending_on_interrupt(source), progress(f"calibrating from {recording.name}"):
        calibration = st.calibrate(seen, config)
    calibration.provenance["recording"] = recording.name
    calibration.save(args.output)
    if args.plot is not None:
        save_calibration_plot(calibration, args.plot)
    found = summary(calibration) | {"anomalies": anomalies_of(source)}
    written = f"written: {args.output}" + (f", {args.plot}" if args.plot else "")
    shown = (_table(calibration, found, args), *_notes(calibration, found), written)
    return tell(args.json, {"output": str(args.output), **found}, *shown)


def _set_scale(args: Args, path: Path) -> int:
    """Write a calibration that is there already with the scale of ``--pitch-mm``."""
    if args.pitch_mm is None or not args.pitch_mm > 0.0:
        raise st.ConfigError(
            f"{str(path)!r} is a calibration already; calibrate learns from a recording, and sets "
            "the scale of a calibration: --pitch-mm 2.4 (above 0)"
        )
    args.refuse(f"is for recordings, and {str(path)!r} is a calibration", "sensor", *OF_RECORDINGS)
    require_free(args.output, args.overwrite, ENDINGS)
    calibration = st.Calibration.load(path).with_pitch(args.pitch_mm)
    calibration.save(args.output)
    document = {"output": str(args.output), "px_per_mm": calibration.px_per_mm}
    return tell(args.json, document, f"written: {args.output}, {calibration.px_per_mm:.3f} px/mm")


def _guided(
    source: st.EventSource, config: st.CalibrationConfig, until_ready: bool
) -> Iterator[st.EventPacket]:
    """Yield a camera's packets, and tell what the calibration still lacks.

    Args:
        source: Where the events come from.
        config: What is known of the sensor.
        until_ready: End once a calibration has all that it needs.
    """
    from spikingtac.viewer.guide import CalibrationGuide

    guide = CalibrationGuide(source.size, config)
    told_us: int | None = None
    for packet in source:
        guide.absorb(packet)
        yield packet
        told_us = packet.t_start_us if told_us is None else told_us
        if packet.t_end_us - told_us >= TELL_US:
            told_us = packet.t_end_us
            remark(guide.view().progress_line())
        if until_ready and guide.complete:
            getattr(source, "close", bool)()  # a recording has none
            break
    remark(guide.view().progress_line())


def summary(calibration: st.Calibration) -> dict[str, Any]:
    """Return the figures of a calibration for people and programs."""
    notes = calibration.provenance
    return {
        "grid": calibration.grid,
        "size": list(calibration.size),
        "markers": len(calibration.radius_px),
        "measured": len(calibration.radius_px) - len(notes["missing"]),
        "quality": notes["quality"],
        "radius_px": float(calibration.radius_px.mean()),
        **{name: getattr(calibration, name) for name in TOLD},
        "lens": None if calibration.lens is None else calibration.lens.document(),
        "hot_px": [] if calibration.hot_px is None else calibration.hot_px.tolist(),
        "method": notes["method"],
        "unloaded_rests": len(notes["unloaded_rests_us"]),
        **{name: notes[name] for name in NOTED},
        **{name: notes.get(name) for name in UNUSUAL},
    }


def _table(calibration: st.Calibration, found: dict[str, Any], args: Args) -> Table:
    same = (*TOLD[1:], "unloaded_rests")
    radii = calibration.radius_px
    measured = f"{found['measured']} of {found['markers']} markers measured"
    grid = "x".join(map(str, calibration.grid or ("none",)))
    told = {
        "quality": f"{found['quality']}, {measured}",
        "grid": f"{grid}, {calibration.polarity} markers",
        "radius": f"{radii.mean():.2f} px, {radii.min():.2f} to {radii.max():.2f}",
        **{name: found[name] for name in same},
        "changes that discs explain": f"{median_high(found['explained']):.0%}",
        "residual, levels": median_high(found["residual"]),
        "scatter over the rests_px": median_high(found["scatter_px"]),
    }
    if (lens := calibration.lens) is not None:
        doubt = f"+- {lens.radial_sigma:.4f}, residual {1e3 * lens.residual_mm:.0f} um"
        told["lens, radial"] = f"{lens.radial:.4f} {doubt}"
    return figures(str(args.output), told)


def _notes(calibration: st.Calibration, found: dict[str, Any]) -> list[str]:
    from spikingtac.markers.calibration.layout import marker_name

    hot, left_out, stray = (found[name] or [] for name in ("hot_px", "left_out_px", "stray_px"))
    places = "; ".join(f"x {x:.0f}, y {y:.0f} px" for x, y in stray[:MOST_NAMED])
    missing, doubtful = (
        [marker_name(marker, calibration.grid) for marker in found[name]]
        for name in ("missing", "doubtful")
    )
    notes = {
        "An event is more than half of the way from ground to marker, so places err by pixels: "
        "lower the camera's thresholds (biases) or add light.": found["coarse_steps"],
        f"The light flickers at {found['flicker_hz']} Hz: use direct current.": found["flicker_hz"],
        f"ON and OFF events balance as badly as where {found['event_loss'] or 0:.0%} of the events "
        "are lost, so places may err by more: raise the camera's thresholds (biases), or use a "
        "faster link.": found["event_loss"],
        f"No lens: {found['no_lens']}.": found["no_lens"],
        f"Hot pixels, whose events are ignored: {len(hot)}.": hot,
        f"Left out, since they lie beyond the border: {len(left_out)}.": left_out,
        f"{len(stray)} spots move like markers and belong to no row: {places}.": stray,
        f"Hardly moved, or hidden; expected from the others: {'; '.join(missing)}.": missing,
        f"Doubtful, since discs explain little of them: {'; '.join(doubtful)}.": doubtful,
    }
    counted = messages.counted(found["anomalies"])
    return [*counted, *(text for text, applies in notes.items() if applies)]


def _check(args: Args, known: Path) -> int:
    """Check one recording, or many into a folder; 1 where one does not fit."""
    args.refuse("is for a new calibration, not for --check", "pitch_mm", *OF_RECORDINGS)
    if means_many(args, args.recordings):
        return run_many(CHECK, args, args.recordings)
    args.refuse("with --check is the folder of many", "output")
    recording = args.recordings[0]
    with progress(f"checking {recording.name}"):
        found = check_one(args, recording, None, no_progress)
    fit = f"{found['contradiction']:.1%} of the pixels contradict, at most {found['limit']:.0%}"
    verdict = found["words"] or f"{recording.name} fits {known.name}: {fit}"
    tell(args.json, found, Table(verdict, (), ()))
    return 0 if found["fits"] else 1  # the input is at fault


def check_one(args: Args, recording: Path, output: Path | None, advance: Advance) -> dict[str, Any]:
    """Check a recording, and write what was found."""
    from spikingtac.markers.calibration_check import CalibrationCheck

    assert args.check is not None
    source = args.open(recording)
    check = CalibrationCheck(fitting(args.check, source))
    for packet in source:
        check.absorb(packet)
        if check.ended:
            break
    check.finish()
    found = {
        "recording": recording.name,
        "fits": check.measured and not check.foreign,
        "contradiction": float(check.contradiction),
        "limit": float(check.limit),
        "words": check.words() if check.foreign else "" if check.measured else TOO_STILL,
    }
    if output is not None:
        write_json(output, found)
    return found


def check_row(found: dict[str, Any]) -> dict[str, Any]:
    """Return the row of one of many recordings."""
    return {"fits": int(found["fits"]), **{n: found[n] for n in ("contradiction", "limit")}}


CHECK = Work(
    "calibrate --check",
    check_one,
    check_row,
    lambda *_: (),
    ENDINGS,
    lambda args: st.Calibration.load(args.check),
)
