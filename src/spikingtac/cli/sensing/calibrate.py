"""``spikingtac calibrate``: learn where the markers rest from bootstrap slides."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from spikingtac.cli.messages import emit_json, emit_table, progress, remark
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.calibration.sensor_calibration import Calibration

FEWEST_SWINGS = 2.0
"""Full swings per pixel below which a marker's steps are hardly its own: worth a remark."""


@dataclass(frozen=True, kw_only=True)
class Args:
    """Learn where the markers rest, how large they are and what an event stands for.

    The recording begins with an unloaded skin; then an object slides over all of it, to and fro in
    several directions, by more than a marker's diameter, and is lifted between the slides.
    """

    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """Event file or recording folder."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("calibration.json")
    """File to write."""
    grid: Annotated[str | None, tyro.conf.arg(metavar="ROWSxCOLUMNS")] = None
    """Size of the grid, as 8x8; found by itself unless given."""
    pitch_mm: float | None = None
    """Distance of neighbouring markers on the skin, mm; gives px_per_mm."""
    polarity: Literal["white", "dark"] = "white"
    """White markers on dark ground, or dark on light."""
    method: Literal["rest-mean", "bounding-box"] = "rest-mean"
    """How rests become a reference; bounding-box is the published one."""
    allow_missing: int = 0
    """So many markers may be missing (broken): they are put where the others expect them."""
    plot: Path | None = None
    """Picture to write: the reference circles over the map painted from them and the steps."""
    sensor: int = 0
    """In a folder, the sensor to read: 1 reads events_1.raw."""
    strict: bool = False
    """Refuse a damaged recording instead of mending it."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Calibrate, write the file, and say what was found."""
    from spikingtac.events.open import open_events
    from spikingtac.markers.calibration.calibrate import CalibrationConfig, calibrate

    config = CalibrationConfig(
        grid=grid_shape(args.grid),
        pitch_mm=args.pitch_mm,
        polarity=args.polarity,
        method=args.method,
        allow_missing=args.allow_missing,
    )
    source = open_events(args.recording, strict=args.strict, sensor=args.sensor)
    with progress(f"calibrating from {args.recording.name}"):
        calibration = calibrate(source, config)
    calibration.provenance["recording"] = args.recording.name
    calibration.save(args.output)
    if args.plot is not None:
        from spikingtac.plots.calibration import save_calibration_plot

        save_calibration_plot(calibration, args.plot)
    if args.json:
        emit_json({"output": str(args.output), **summary(calibration)})
    else:
        _print(calibration, args)
    return 0


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
        "markers": len(calibration.radius_px),
        "radius_px": float(calibration.radius_px.mean()),
        "contrast": calibration.contrast,
        "edge_px": calibration.edge_px,
        "step_on": calibration.step_on,
        "step_off": calibration.step_off,
        "lag_us": calibration.lag_us,
        "px_per_mm": calibration.px_per_mm,
        "method": notes["method"],
        "unloaded_rests": len(notes["unloaded_rests_us"]),
        "missing": notes["missing"],
        "unsteady": notes["unsteady"],
        "swings": notes["swings"],
        "residual": notes["residual"],
        "scatter_px": notes["scatter_px"],
    }


def _print(calibration: Calibration, args: Args) -> None:
    found = summary(calibration)
    radii, notes = calibration.radius_px, calibration.provenance
    rows = [
        ("grid", "x".join(map(str, calibration.grid)), "rows x columns"),
        ("radius", f"{radii.mean():.2f}", f"px, {radii.min():.2f} to {radii.max():.2f}"),
        ("contrast", f"{found['contrast']:.2f}", "ratio, at a threshold of 0.25"),
        ("edge", f"{found['edge_px']:.2f}", "px"),
        ("step ON, OFF", f"{found['step_on']:.3f}, {found['step_off']:.3f}", "of a full swing"),
        ("unloaded rests", found["unloaded_rests"], found["method"]),
    ]
    if calibration.lag_us is not None:
        rows.append(("lag", f"{calibration.lag_us / 1e3:.2f}", "ms, events behind the motion"))
    if calibration.px_per_mm is not None:
        rows.append(("scale", f"{calibration.px_per_mm:.3f}", "px/mm"))
    for name, key, unit in (
        ("full swings", "swings", "per pixel"),
        ("residual", "residual", "levels, rms"),
        ("scatter", "scatter_px", "px over the rests"),
    ):
        values = sorted(found[key])
        middle = values[len(values) // 2]
        rows.append((name, f"{middle:.3g}", f"{unit}, {values[0]:.3g} to {values[-1]:.3g}"))
    emit_table(str(args.output), ("", "", ""), rows, words=3)
    few = [i for i, value in enumerate(notes["swings"]) if value < FEWEST_SWINGS]
    for what, markers in (
        ("missing, put where the others expect them", found["missing"]),
        ("hardly seen to move, slide over them more", sorted({*few} - {*found["missing"]})),
        ("unsteady, their edge often disagreed with a disc", found["unsteady"]),
    ):
        if markers:
            remark(f"note: markers {what}: {', '.join(_named(calibration, i) for i in markers)}")


def _named(calibration: Calibration, marker: int) -> str:
    row, column = divmod(marker, calibration.grid[1])
    return f"row {row + 1} column {column + 1}"
