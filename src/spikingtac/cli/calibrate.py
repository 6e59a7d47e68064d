"""``spikingtac calibrate``: learn where the markers rest, and how they look."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.cli.calibrate_args import Args
from spikingtac.cli.calibrate_check import run_check
from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.many import means_many
from spikingtac.cli.messages import emit_json, emit_table, progress, remark
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.events.source import EventSource
    from spikingtac.markers.calibration.calibrate import CalibrationConfig

MOST_NAMED = 8
"""Stray spots that are named one by one."""


def run(args: Args) -> int:
    """Calibrate, write the file, and say what was found; or check."""
    if args.check is not None:
        return run_check(args, args.check)
    recording = _only_one(args)
    from spikingtac.atomic_files import require_free
    from spikingtac.events.open import open_events
    from spikingtac.file_kinds import kind_of
    from spikingtac.markers.calibration.calibrate import CalibrationConfig, calibrate

    for path in (args.output, args.plot):
        if path is not None:
            require_free(path, args.overwrite)
    if kind_of(recording) == "calibration":
        return _set_scale(args, recording)
    config = CalibrationConfig(
        grid=grid_shape(args.grid),
        pitch_mm=args.pitch_mm,
        lens=args.lens,
        polarity=args.polarity,
        layout=args.layout,
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
        remark(f"written: {args.output}" + (f", {args.plot}" if args.plot else ""))
    return 0


def _set_scale(args: Args, path: Path) -> int:
    """Write a calibration that is there already with the scale of ``--pitch-mm``."""
    from spikingtac.calibration.sensor_calibration import Calibration

    if args.pitch_mm is None:
        raise ConfigError(
            f"{str(path)!r} is a calibration already; calibrate learns from a recording, and sets "
            "the scale of a calibration: --pitch-mm 2.4"
        )
    if not args.pitch_mm > 0.0:
        raise ConfigError(f"--pitch-mm is {args.pitch_mm:g}, it must be above 0")
    calibration = Calibration.load(path).with_pitch(args.pitch_mm)
    calibration.save(args.output)
    if args.json:
        emit_json({"output": str(args.output), "px_per_mm": calibration.px_per_mm})
    else:
        remark(f"written: {args.output}, {calibration.px_per_mm:.3f} px/mm")
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
    from spikingtac.events.evt.raw_stream import is_stream
    from spikingtac.markers.calibration.advice import GuidedSource, progress_line
    from spikingtac.markers.calibration.guide import CalibrationGuide

    if not (args.guide or args.until_ready or is_stream(args.recordings[0])):
        return source
    guide = CalibrationGuide(source.size, config.grid, config.polarity, config.layout)
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
        "grid": calibration.rows_and_columns,
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
        "lens": None if calibration.lens is None else calibration.lens.document(),
        "no_lens": notes.get("no_lens"),
        "hot_px": [] if calibration.hot_px is None else calibration.hot_px.tolist(),
        "method": notes["method"],
        "unloaded_rests": len(notes["unloaded_rests_us"]),
        **{
            name: notes[name]
            for name in ("missing", "doubtful", "explained", "events", "swings", "residual")
        },
        "scatter_px": notes["scatter_px"],
        **{name: notes.get(name) for name in ("left_out_px", "stray_px", "fitting_grid")},
    }


def _print(calibration: Calibration, args: Args) -> None:
    found = summary(calibration)
    radii = calibration.radius_px
    explained = middle_of(found["explained"])
    shown = f"{found['measured']} of {found['markers']} markers measured"
    rows = [
        ("quality", found["quality"], f"{shown}; discs explain {explained:.0%} of the changes"),
        ("grid", _shape(calibration.grid), f"rows x columns, {calibration.polarity}"),
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
    if (lens := calibration.lens) is not None:
        doubt = f"+- {lens.radial_sigma:.4f}, residual {1e3 * lens.residual_mm:.0f} um"
        rows.append(("lens", f"{lens.radial:.4f}", f"radial, {doubt}"))
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
    for note in _notes(found):
        remark(note)
    for marker in found["missing"]:
        remark(f"{_named(calibration, marker)} never moved: its place is expected from the others.")
    if found["doubtful"]:
        named = ", ".join(_named(calibration, marker) for marker in found["doubtful"])
        remark(f"Doubtful, since discs explain little of what was seen there: {named}.")


def middle_of(values: list[float]) -> float:
    """Return the middle one of some numbers."""
    return float(sorted(values)[len(values) // 2])


def _shape(grid: tuple[int, int] | list[int] | None) -> str:
    return "none" if grid is None else "x".join(map(str, grid))


def _notes(found: dict[str, Any]) -> list[str]:
    notes = []
    if found["no_lens"]:
        notes.append(f"No lens: {found['no_lens']}.")
    if found["hot_px"]:
        notes.append(f"Hot pixels, whose events are ignored: {len(found['hot_px'])}.")
    if found["left_out_px"]:
        notes.append(f"Left out, since they lie beyond the border: {len(found['left_out_px'])}.")
    if stray := found["stray_px"]:
        places = "; ".join(f"x {x:.0f}, y {y:.0f} px" for x, y in stray[:MOST_NAMED])
        notes.append(f"{len(stray)} spots move like markers and belong to no row: {places}.")
    if found["fitting_grid"]:
        fits = _shape(found["fitting_grid"])
        notes.append(f"The grid {fits} fits all that moves: give --grid {fits}.")
    return notes


def _named(calibration: Calibration, marker: int) -> str:
    from spikingtac.markers.calibration.quality import marker_name

    return marker_name(marker, calibration.grid)
