"""``spikingtac probe``: find centre and radius of one hole by touch, on the twin or a real arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from spikingtac.cli.messages import emit_json, emit_table, remark
from spikingtac.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Args:
    """Find centre and radius of one hole by touch; on the twin unless an arm is named.

    The probe must stand in the hole. Not a safety function: nothing here replaces the robot's own
    protective stop.
    """

    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FOLDER|FILE")] = None
    """Folder for hole.json and hole.png; or a .json, .png, .svg or .pdf file, the other beside
    it."""
    arm: str | None = None
    """Address of a UR arm in remote control; the twin unless told."""
    events: Path | None = None
    """With --arm: where the finger's events come from (anything that info reads)."""
    calibration: Path | None = None
    """With --arm: calibration.json of that finger."""
    travel_mm: float = 0.12
    """With --arm: delta_crit, the tip's travel from touch to decision, mm, from a known wall."""
    travel_sigma_mm: float = 0.03
    """With --arm: its standard deviation from touch to touch, mm."""
    radius_mm: float = 2.0
    """On the twin: the hole's true radius, mm."""
    start_mm: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y")] = None
    """On the twin: where the probe begins, mm from the hole's centre; at random inside unless
    given."""
    seed: int = 0
    """On the twin: of everything random."""
    search: Literal["default", "cross4"] = "default"
    """The adaptive search, or the paper's four contacts."""
    contacts: int = 12
    """Most contacts of the adaptive search."""
    center_sigma_mm: float = 0.0
    """The adaptive search ends once the centre is known this well along each axis, mm."""
    travel_limit_mm: float = 11.0
    """Longest way of one approach, mm; a hole must be smaller."""
    force_limit_n: float = 0.5
    """Force that the tip must not exceed though no wall be felt, N; shortens the way where
    needed."""
    detector: Literal["default", "event_count"] = "default"
    """Contact detector: default (signed, sequential) or event_count (as published)."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Probe, write, and say where the hole is."""
    from spikingtac.cli.robot.probe_places import check, on_arm, on_twin
    from spikingtac.cli.robot.probe_result import output_paths, write

    if args.arm is not None and (args.events is None or args.calibration is None):
        raise ConfigError("--arm needs --events and --calibration: the finger that listens")
    check(args)
    paths = output_paths(args.output)
    found = on_arm(args) if args.arm else on_twin(args)
    summary = found.summary() | (write(found, paths) if paths else {})
    if args.json:
        emit_json(summary)
    else:
        _print(summary)
    return 0


def _print(summary: dict[str, Any]) -> None:
    rows = [
        (name, summary[name], summary[f"{name}_sigma"], summary.get(f"{name}_error", "-"))
        for name in ("x_mm", "y_mm", "radius_mm")
    ]
    columns = ("", "estimate", "standard deviation", "error (simulated)")
    place = "simulated" if summary["simulated"] else "real arm"
    emit_table(f"hole from {summary['contacts']} contacts ({place})", columns, rows)
    if "output" in summary:
        remark(f"written: {summary['output']}, {summary['picture']}")
