"""The arguments of ``spikingtac probe``, their checks, and the search on twin and arm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.cli.options import WriteArgs
from spikingtac.contact.registry import detectors
from spikingtac.errors import ConfigError, named
from spikingtac.geometry.hole import Circle
from spikingtac.geometry.travel import TravelModel
from spikingtac.robot.adaptive_search import AdaptiveSearch, AdaptiveSearchConfig
from spikingtac.robot.cross_search import calibrated_circle, cross_search
from spikingtac.robot.prober import Prober, ProbingConfig, Touched
from spikingtac.types import FloatArray

# Arguments that must be above 0.
POSITIVE = ("travel_mm", "travel_sigma_mm", "travel_limit_mm", "force_limit_n")
LEAST_RADIUS_MM = 0.5  # Radius of the narrowest hole of the twin, mm: the bit reaches 0.433 mm.

# Assumptions of every search.
ASSUMPTIONS = (
    "the hole is round, and deep enough that only its side is met",
    "the bit is a hexagon of 0.75 mm across flats",
)


SEARCHES = ("default", "cross4")  # Names of the searches: adaptive, and the paper's four contacts.


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
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


def check(args: Args) -> None:
    """Refuse invalid arguments before anything moves or is computed.

    Raises:
        ConfigError: Names the flag, what was given and what is valid.
    """
    named(dict.fromkeys(SEARCHES), args.search, "search")
    named(detectors(), args.detector, "contact detector")
    for name in POSITIVE:
        value = getattr(args, name)
        if not (value > 0.0 and math.isfinite(value)):
            raise ConfigError(f"--{name.replace('_', '-')} is {value:g}; it must be above 0")
    if not (args.radius_mm >= LEAST_RADIUS_MM and math.isfinite(args.radius_mm)):
        raise ConfigError(
            f"--radius-mm is {args.radius_mm:g}; the bit reaches 0.433 mm and needs some room: "
            f"at least {LEAST_RADIUS_MM} mm"
        )
    if args.arm is not None:
        _check_arm(args)
    elif args.rehearsal:
        raise ConfigError("--rehearsal is for an arm; give its address: --arm HOST")
    elif args.gripper:
        raise ConfigError("--gripper is for an arm; give its address: --arm HOST")
    if args.release and not args.gripper:
        raise ConfigError("--release opens the gripper that --gripper closed; give --gripper too")
    if args.search == "default":
        search_config(args)


def _check_arm(args: Args) -> None:
    from spikingtac.events.address import is_stream

    if args.events is None or args.calibration is None:
        raise ConfigError(
            "--arm needs --events and --calibration: those of the finger that holds the probe"
        )
    if not args.rehearsal and not is_stream(args.events):
        raise ConfigError(
            f"--events is {str(args.events)!r}, which is no camera's named pipe: an arm that moves "
            "by a recording feels nothing. Give the pipe, or --rehearsal if nothing can be touched"
        )


def probing_style(args: Args) -> ProbingConfig:
    """Return how the search touches."""
    style = ProbingConfig() if args.search == "cross4" else ProbingConfig.conditioned()
    return replace(style, travel_limit_mm=args.travel_limit_mm, force_limit_n=args.force_limit_n)


def search_config(args: Args) -> AdaptiveSearchConfig:
    """Return the settings of the adaptive search.

    Raises:
        ConfigError: There are too few contacts.
    """
    return AdaptiveSearchConfig(contacts=args.contacts, center_sigma_mm=args.center_sigma_mm)


def search(
    args: Args, prober: Prober, travel: TravelModel, start_mm: FloatArray
) -> tuple[Circle, Sequence[Touched]]:
    """Search a hole, and return the estimate with its contacts.

    Args:
        args: The arguments of the verb.
        prober: Makes the touches.
        travel: Calibrated travel.
        start_mm: ``(2,)`` start inside the hole, mm.

    Raises:
        SearchError: There is no wall, no room, or no circle; the arm is at rest.
    """
    if args.search == "cross4":
        touches = cross_search(prober, start_mm, travel)
        return calibrated_circle(touches, travel), touches
    found = AdaptiveSearch(prober, travel, search_config(args)).run(start_mm)
    return found.circle, found.touches


def resolved_config(args: Args) -> dict[str, Any]:
    """Return the settings of the search by stage, for the document."""
    config: dict[str, Any] = {"probing": probing_style(args), "detector": args.detector}
    if args.search == "default":
        config["search"] = search_config(args)
    return config
