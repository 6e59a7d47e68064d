"""``spikingtac calibrate``: learn where the markers rest, and how they look."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.many import ManyArgs, means_many
from spikingtac.cli.messages import emit_json, emit_table, progress, remark
from spikingtac.cli.sensing.calibrate_check import run_check
from spikingtac.errors import ConfigError
from spikingtac.markers.calibration.reference import Method
from spikingtac.types import Polarity

if TYPE_CHECKING:
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.events.source import EventSource
    from spikingtac.markers.calibration.calibrate import CalibrationConfig


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs):
    """Learn where the markers rest, how large they are and what an event stands for.

    Any recording will do in which the markers move: presses, contacts or slides. It is best when
    it begins without load, when every marker moves by more than its diameter, and when the skin
    rests for half a second between contacts.

    With --check, whether recordings come from the sensor of a calibration; many go into a folder:
    spikingtac calibrate --check left_finger.json DAY -o DAY_checked --workers 4
    """

    recordings: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RECORDING")
    ]
    """Event file, recording folder, or a camera: its address, a named pipe, or -. With --check also
    several, a folder of recordings or a pattern such as 'day/*.raw'."""
    check: Annotated[Path | None, tyro.conf.arg(metavar="CALIBRATION")] = None
    """Write no calibration: say whether the recordings fit this one."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("calibration.json")
    """File to write; with --check the folder for many."""
    grid: Annotated[str | None, tyro.conf.arg(metavar="ROWSxCOLUMNS")] = None
    """Size of the grid, as 8x8; found by itself unless given."""
    pitch_mm: float | None = None
    """Distance of neighbouring markers on the skin, mm; gives px_per_mm."""
    polarity: Literal["auto"] | Polarity = "auto"
    """White markers on dark ground, or dark on light; found by itself unless given."""
    method: Method = "rest-mean"
    """How rests become a reference; bounding-box is the published one."""
    allow_missing: int | None = None
    """So many markers may be missing: they are put where the others expect them. A third of them
    may be missing unless given."""
    plot: Path | None = None
    """Picture to write: the markers as circles, good and doubtful ones told apart."""
    sensor: int = 0
    """In a folder, the sensor to read: 1 reads events_1.raw."""
    guide: bool = False
    """Say every two seconds which markers still have to move, as is always done for a camera."""
    until_ready: bool = False
    """End a camera by itself once every marker has moved enough and the skin rests."""
    strict: bool = False
    """Refuse a damaged recording instead of mending it."""


def run(args: Args) -> int:
    """Calibrate, write the file, and say what was found; or check."""
    if args.check is not None:
        return run_check(args, args.check)
    recording = _only_one(args)
    from spikingtac.atomic_files import require_free
    from spikingtac.events.open import open_events
    from spikingtac.markers.calibration.calibrate import CalibrationConfig, calibrate

    for path in (args.output, args.plot):
        if path is not None:
            require_free(path, args.overwrite)
    config = CalibrationConfig(
        grid=grid_shape(args.grid),
        pitch_mm=args.pitch_mm,
        polarity=args.polarity,
        method=args.method,
        allow_missing=args.allow_missing,
    )
    source = open_events(recording, strict=args.strict, sensor=args.sensor)
    guided = _guided(source, config, args)
    with ending_on_interrupt(source), progress(f"calibrating from {recording.name}"):
        calibration = calibrate(guided, config)
    calibration.provenance["recording"] = recording.name
    calibration.save(args.output)
    if args.plot is not None:
        from spikingtac.plots.calibration import save_calibration_plot

        save_calibration_plot(calibration, args.plot)
    if args.json:
        emit_json({"output": str(args.output), **summary(calibration)})
    else:
        _print(calibration, args)
    return 0


def _only_one(args: Args) -> Path:
    """Return the recording to learn from.

    Raises:
        ConfigError: Several are given, or options that are for several.
    """
    if means_many(args, args.recordings):
        raise ConfigError(
            "calibrate learns from one recording; to check many against a calibration: "
            "spikingtac calibrate --check calibration.json DAY -o DAY_checked"
        )
    return args.recordings[0]


def _guided(source: EventSource, config: CalibrationConfig, args: Args) -> EventSource:
    """Return the source; that of a camera tells what the calibration still lacks."""
    from spikingtac.events.formats.evt.raw_stream import is_stream
    from spikingtac.markers.calibration.guide.advice import progress_line
    from spikingtac.markers.calibration.guide.guide import CalibrationGuide
    from spikingtac.markers.calibration.guide.guided_source import GuidedSource

    if not (args.guide or args.until_ready or is_stream(args.recordings[0])):
        return source
    guide = CalibrationGuide(source.size, config.grid, config.polarity)
    return GuidedSource(
        source, guide, lambda view: remark(progress_line(view)), until_ready=args.until_ready
    )


def grid_shape(text: str | None) -> tuple[int, int] | None:
    """Return ``(rows, columns)`` from text such as ``8x8``.

    Raises:
        ConfigError: The text is of another form.
    """
    if text is None:
        return None
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise ConfigError(f"--grid is {text!r}, valid is ROWSxCOLUMNS, such as 8x8 or 7x10")
    return int(parts[0]), int(parts[1])


def summary(calibration: Calibration) -> dict[str, Any]:
    """Return the figures of a calibration for people and programs."""
    notes = calibration.provenance
    return {
        "grid": list(calibration.grid),
        "size": list(calibration.size),
        "polarity": calibration.polarity,
        "markers": len(calibration.radius_px),
        "measured": len(calibration.radius_px) - len(notes["missing"]),
        "quality": notes["quality"],
        "radius_px": float(calibration.radius_px.mean()),
        "contrast": calibration.contrast,
        "edge_px": calibration.edge_px,
        "step_on": calibration.step_on,
        "step_off": calibration.step_off,
        "lag_us": calibration.lag_us,
        "px_per_mm": calibration.px_per_mm,
        "method": notes["method"],
        "unloaded_rests": len(notes["unloaded_rests_us"]),
        **{
            name: notes[name]
            for name in ("missing", "doubtful", "explained", "events", "swings", "residual")
        },
        "scatter_px": notes["scatter_px"],
    }


def _print(calibration: Calibration, args: Args) -> None:
    found = summary(calibration)
    radii = calibration.radius_px
    explained = middle_of(found["explained"])
    shown = f"{found['measured']} of {found['markers']} markers measured"
    rows = [
        ("quality", found["quality"], f"{shown}; discs explain {explained:.0%} of the changes"),
        ("grid", "x".join(map(str, calibration.grid)), f"rows x columns, {calibration.polarity}"),
        ("radius", f"{radii.mean():.2f}", f"px, {radii.min():.2f} to {radii.max():.2f}"),
        ("edge", f"{found['edge_px']:.2f}", "px, logistic scale"),
        ("contrast", f"{found['contrast']:.2f}", "ratio, at a threshold of 0.25"),
        ("step ON, OFF", f"{found['step_on']:.3f}, {found['step_off']:.3f}", "of a full swing"),
        ("unloaded rests", found["unloaded_rests"], found["method"]),
    ]
    if calibration.lag_us is not None:
        rows.append(("lag", f"{calibration.lag_us / 1e3:.2f}", "ms, events behind the motion"))
    if calibration.px_per_mm is not None:
        rows.append(("scale", f"{calibration.px_per_mm:.3f}", "px/mm"))
    for name, key, unit in (
        ("full swings", "swings", "per marker"),
        ("residual", "residual", "levels, rms"),
        ("scatter", "scatter_px", "px over the rests"),
    ):
        values = sorted(found[key])
        rows.append(
            (name, f"{middle_of(values):.3g}", f"{unit}, {values[0]:.3g} to {values[-1]:.3g}")
        )
    emit_table(str(args.output), ("", "", ""), rows, words=3)
    for marker in found["missing"]:
        remark(f"{_named(calibration, marker)} never moved: its place is expected from the others.")
    if found["doubtful"]:
        named = ", ".join(_named(calibration, marker) for marker in found["doubtful"])
        remark(f"Doubtful, since discs explain little of what was seen there: {named}.")


def middle_of(values: list[float]) -> float:
    """Return the middle one of some numbers."""
    return float(sorted(values)[len(values) // 2])


def _named(calibration: Calibration, marker: int) -> str:
    row, column = divmod(marker, calibration.grid[1])
    return f"row {row + 1} column {column + 1}"
