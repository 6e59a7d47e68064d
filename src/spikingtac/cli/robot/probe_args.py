"""The arguments of ``spikingtac probe``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac.cli.options import WriteArgs
from spikingtac.contact.registry import detectors

SEARCHES = ("default", "cross4")
"""Names of the searches: adaptive, and the paper's four contacts."""


@dataclass(frozen=True, kw_only=True)
class ProbeArgs(WriteArgs):
    """Find centre and radius of one hole by touch; on the twin unless an arm is given.

    The probe must stand in the hole. This is not a safety function: it does not replace the robot's
    protective stop.
    """

    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FOLDER|FILE")] = None
    """Folder for hole.json and hole.png; or a .json, .png, .svg or .pdf file, the other one is
    written beside it. Nothing is written unless given."""
    arm: str | None = None
    """Address of a UR arm in remote control; the twin is used unless given."""
    events: Path | None = None
    """With --arm: the finger's camera, a named pipe; a recording only with --rehearsal."""
    rehearsal: bool = False
    """With --arm: allow --events to be a recording. The arm then moves by what was felt earlier,
    and feels nothing: no contact stops it."""
    calibration: Path | None = None
    """With --arm: calibration.json of that finger."""
    gripper: bool = False
    """With --arm: close the Robotiq gripper of the arm's controller on the probe before the search,
    and report the grip."""
    release: bool = False
    """With --gripper: open the gripper after the search."""
    travel_mm: float = 0.12
    """With --arm: delta_crit, the tip's travel from touch to decision, mm, from a known wall."""
    travel_sigma_mm: float = 0.03
    """With --arm: standard deviation of this travel from touch to touch, mm."""
    radius_mm: float = 2.0
    """On the twin: true radius of the hole, mm."""
    start_mm: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y")] = None
    """On the twin: start of the probe, mm from the hole's centre; random inside the hole unless
    given."""
    seed: int = 0
    """On the twin: seed of everything random."""
    search: Annotated[str, tyro.conf.arg(metavar="|".join(SEARCHES))] = "default"
    """default (adaptive) or cross4 (the paper's four contacts)."""
    contacts: int = 12
    """Largest number of contacts of the adaptive search."""
    center_sigma_mm: float = 0.0
    """The adaptive search ends when the standard deviation of the centre is below this along each
    axis, mm."""
    travel_limit_mm: float = 11.0
    """Largest travel of one approach, mm; a hole must be smaller."""
    force_limit_n: float = 0.5
    """Largest force of the tip, N, even if no wall is detected; it limits the travel."""
    detector: Annotated[str, tyro.conf.arg(metavar="|".join(detectors()))] = "default"
    """Contact detector: default (signed, sequential) or event_count (as published)."""
