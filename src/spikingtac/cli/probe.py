"""``spikingtac probe``: find centre and radius of one hole by touch, on the twin or a real arm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from spikingtac.cli.output import emit_json, emit_table, progress
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.geometry.hole import Circle
    from spikingtac.geometry.travel import TravelModel
    from spikingtac.robot.prober import Prober
    from spikingtac.types import EventPacket

QUIET_WINDOWS = 4000
"""Windows of the arm at rest that the detector learns from, of 1 ms."""
LEAST_RADIUS_MM = 0.5
"""Narrowest hole of the twin, mm."""
TWIN_CYCLES = 3
"""Calibration touches per direction on the twin: thirty in all."""


@dataclass(frozen=True, kw_only=True)
class Args:
    """Find centre and radius of one hole by touch; on the twin unless an arm is named.

    The probe must stand in the hole. Not a safety function: nothing here replaces the robot's own
    protective stop.
    """

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
    seed: int = 0
    """On the twin: of everything random."""
    search: Literal["default", "cross4"] = "default"
    """The adaptive search, or the paper's four contacts."""
    contacts: int = 12
    """Most contacts of the adaptive search."""
    center_sigma_mm: float = 0.0
    """The adaptive search ends once the centre is known this well along each axis, mm."""
    detector: str = "default"
    """Contact detector: default or event_count."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Probe, and say where the hole is."""
    found = _on_arm(args) if args.arm else _on_twin(args)
    if args.json:
        emit_json(found)
        return 0
    rows = [
        (name, found[name], found[f"{name}_sigma"], found.get(f"{name}_error", "-"))
        for name in ("x_mm", "y_mm", "radius_mm")
    ]
    columns = ("", "estimate", "standard deviation", "error (simulated)")
    emit_table(f"Hole from {found['contacts']} contacts", columns, rows)
    return 0


def _on_twin(args: Args) -> dict[str, Any]:
    import numpy as np

    from spikingtac.experiments import hole_touching as touching
    from spikingtac.sim.hole_site import Grasp, HoleSite, hole_trial

    if args.radius_mm < LEAST_RADIUS_MM:
        raise ConfigError(
            f"radius_mm is {args.radius_mm}; the bit reaches 0.433 mm and needs some room: "
            f"at least {LEAST_RADIUS_MM} mm"
        )
    style = touching.DEFAULT if args.search == "default" else touching.CROSS
    trial = hole_trial(args.radius_mm, np.zeros(2), touching.CORNER_MM, args.seed)
    site = HoleSite(Grasp.of(args.seed), args.seed)
    with progress("calibrate on a flat wall, then probe") as advance:
        detector = touching.detector_for(site, args.detector, touching.quiet_windows(site))
        prober = touching.prober_for(site, detector, style)
        flat = touching.RecordingProber(prober, [args.seed, 4])
        advance(0.1)
        cycles = TWIN_CYCLES if style == touching.DEFAULT else touching.CYCLES[style]
        touching.touch_flat_walls(site, flat, style, cycles)
        advance(0.5)
        travel = touching.travel_of(flat.kept, touching.PLANNING_MM)
        site.face(trial.wall, trial.start_mm)
        hole = touching.RecordingProber(prober, [args.seed, 5])
        found = _search(args, hole, travel, trial.start_mm)
    circle = found["circle"]
    away = np.append(circle.center_mm - trial.center_mm, circle.radius_mm - args.radius_mm)
    errors = dict(zip(("x_mm_error", "y_mm_error", "radius_mm_error"), away, strict=True))
    rounded = {name: round(float(value), 4) for name, value in errors.items()}
    return _told(circle, found["contacts"]) | rounded | {"source": "twin"}


def _on_arm(args: Args) -> dict[str, Any]:
    from itertools import islice

    from spikingtac.contact.detectors import DetectionConfig, make_detector
    from spikingtac.events.open import open_events
    from spikingtac.events.windows import windows
    from spikingtac.geometry.hole import Compensation
    from spikingtac.geometry.travel import TravelModel
    from spikingtac.robot.prober import ArmProber, ProbingConfig
    from spikingtac.robot.ur import URArm
    from spikingtac.types import Calibration

    if args.arm is None or args.events is None or args.calibration is None:
        raise ConfigError("--arm needs --events and --calibration: the finger that listens")
    calibration = Calibration.load(args.calibration)
    stream: Iterator[tuple[EventPacket, ...]] = (
        (window,) for window in windows(open_events(args.events), period_us=1000)
    )
    quiet = islice(stream, QUIET_WINDOWS)
    detector = make_detector(args.detector, DetectionConfig(), [calibration], quiet)
    known = Compensation(travel_mm=args.travel_mm, travel_sigma_mm=args.travel_sigma_mm)
    style = ProbingConfig() if args.search == "cross4" else ProbingConfig.conditioned()
    arm = URArm(args.arm)
    try:
        prober = ArmProber(arm, stream, detector, style)
        found = _search(args, prober, TravelModel.of(known), prober.place_mm())
    finally:
        arm.close()
    return _told(found["circle"], found["contacts"]) | {"source": "robot"}


def _search(args: Args, prober: Prober, travel: TravelModel, start_mm: Any) -> dict[str, Any]:
    from spikingtac.robot.adaptive_search import AdaptiveSearch, AdaptiveSearchConfig
    from spikingtac.robot.cross_search import calibrated_circle, cross_search

    if args.search == "cross4":
        touches = cross_search(prober, start_mm, travel)
        return {"circle": calibrated_circle(touches, travel), "contacts": len(touches)}
    config = AdaptiveSearchConfig(contacts=args.contacts, center_sigma_mm=args.center_sigma_mm)
    found = AdaptiveSearch(prober, travel, config).run(start_mm)
    return {"circle": found.circle, "contacts": len(found.touches)}


def _told(circle: Circle, contacts: int) -> dict[str, Any]:
    values = [*circle.center_mm, circle.radius_mm]
    told: dict[str, Any] = {"contacts": contacts}
    for name, value, sigma in zip(
        ("x_mm", "y_mm", "radius_mm"), values, circle.sigma_mm, strict=True
    ):
        told[name] = round(float(value), 4)
        told[f"{name}_sigma"] = round(float(sigma), 4)
    return told
