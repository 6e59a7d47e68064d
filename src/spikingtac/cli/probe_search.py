"""What ``spikingtac probe`` shares on twin and arm: arguments, their checks, search and result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from spikingtac.atomic_files import write_json
from spikingtac.cli.options import WriteArgs
from spikingtac.contact.registry import detectors
from spikingtac.errors import ConfigError, named
from spikingtac.geometry.hole import Circle
from spikingtac.geometry.travel import TravelModel
from spikingtac.plots.circles import HolePicture, save_hole_plot
from spikingtac.robot.adaptive_search import AdaptiveSearch, AdaptiveSearchConfig
from spikingtac.robot.cross_search import calibrated_circle, cross_search
from spikingtac.robot.prober import Prober, ProbingConfig, Touched
from spikingtac.schema import to_mapping
from spikingtac.types import FloatArray

# Arguments that must be above 0.
POSITIVE = ("travel_mm", "travel_sigma_mm", "travel_limit_mm", "force_limit_n")
LEAST_RADIUS_MM = 0.5  # Radius of the narrowest hole of the twin, mm: the bit reaches 0.433 mm.
DIGITS = 5  # Decimals of lengths in hole.json, mm: a hundredth of a micrometre.

# Assumptions of every search.
ASSUMPTIONS = (
    "the hole is round, and deep enough that only its side is met",
    "the bit is a hexagon of 0.75 mm across flats",
)


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
    search: Literal["default", "cross4"] = "default"
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

    def check(self) -> None:
        """Refuse invalid arguments before anything moves or is computed.

        Raises:
            ConfigError: Names the flag, what was given and what is valid.
        """
        named(detectors(), self.detector, "contact detector")
        for name in POSITIVE:
            value = getattr(self, name)
            if not (value > 0.0 and math.isfinite(value)):
                raise ConfigError(f"--{name.replace('_', '-')} is {value:g}; it must be above 0")
        if not (self.radius_mm >= LEAST_RADIUS_MM and math.isfinite(self.radius_mm)):
            raise ConfigError(
                f"--radius-mm is {self.radius_mm:g}; the bit reaches 0.433 mm and needs some room: "
                f"at least {LEAST_RADIUS_MM} mm"
            )
        for flag, needed in (("rehearsal", "arm"), ("gripper", "arm"), ("release", "gripper")):
            if getattr(self, flag) and not getattr(self, needed):
                raise ConfigError(f"--{flag} is used with --{needed}; give that, too")
        if self.arm is not None:
            self._check_arm()
        if self.search == "default":
            AdaptiveSearchConfig(contacts=self.contacts, center_sigma_mm=self.center_sigma_mm)

    def _check_arm(self) -> None:
        from spikingtac.events.address import is_stream

        if self.events is None or self.calibration is None:
            raise ConfigError(
                "--arm needs --events and --calibration: those of the finger that holds the probe"
            )
        if not self.rehearsal and not is_stream(self.events):
            raise ConfigError(
                f"--events is {str(self.events)!r}, which is no camera's named pipe: an arm that "
                "moves by a recording feels nothing. Give the pipe, or --rehearsal if nothing can "
                "be touched"
            )

    @property
    def probing(self) -> ProbingConfig:
        """How the search touches."""
        style = ProbingConfig() if self.search == "cross4" else ProbingConfig.conditioned()
        return replace(
            style, travel_limit_mm=self.travel_limit_mm, force_limit_n=self.force_limit_n
        )

    @property
    def searching(self) -> AdaptiveSearchConfig:
        """The settings of the adaptive search."""
        return AdaptiveSearchConfig(contacts=self.contacts, center_sigma_mm=self.center_sigma_mm)


@dataclass(frozen=True, kw_only=True)
class ProbedHole:
    """The estimate of a hole, with the search that led to it.

    Attributes:
        args: The arguments of the verb.
        circle: The estimate.
        touches: The contacts of the estimate, in the order of the circle's residuals.
        travel: The travel by which the readings were corrected.
        assumed: The assumptions, in sentences.
        given: What the search depended on beside its settings.
        true_center_mm: ``(2,)`` the hole's centre, where it is known, mm.
        grip: How the gripper holds the probe; None without a gripper.
    """

    args: Args
    circle: Circle
    touches: Sequence[Touched]
    travel: TravelModel
    assumed: Sequence[str]
    given: dict[str, Any]
    true_center_mm: FloatArray | None = None
    grip: dict[str, Any] | None = None

    @property
    def picture(self) -> HolePicture:
        """What the picture shows."""
        known = self.true_center_mm is not None
        return HolePicture(
            circle=self.circle,
            reading_mm=np.array([touch.reading_mm for touch in self.touches]),
            true_center_mm=self.true_center_mm,
            true_radius_mm=self.args.radius_mm if known else None,
        )

    def summary(self) -> dict[str, Any]:
        """Return the summary that is printed: each coordinate with its sigma and its error."""
        values = {"": [*self.circle.center_mm, self.circle.radius_mm]}
        values["_sigma"] = list(self.circle.sigma_mm)
        if (error_mm := self.picture.error_mm) is not None:
            values["_error"] = list(error_mm)
        told: dict[str, Any] = {"contacts": len(self.touches)}
        for number, name in enumerate(("x_mm", "y_mm", "radius_mm")):
            told |= {f"{name}{kind}": round(float(of[number]), 4) for kind, of in values.items()}
        told |= {} if self.grip is None else {"grip": self.grip}
        simulated = self.args.arm is None
        return told | {"source": "twin" if simulated else "robot", "simulated": simulated}

    def document(self) -> dict[str, Any]:
        """Return the document that is written."""
        from spikingtac._version import package_version

        args, circle, error_mm = self.args, self.circle, self.picture.error_mm
        config = {"probing": args.probing, "detector": args.detector, **self.given}
        if args.search == "default":
            config["search"] = args.searching
        center = {"center_mm": _rounded(circle.center_mm), "radius_mm": _rounded(circle.radius_mm)}
        residuals = zip(self.touches, circle.residual_mm, strict=True)
        contacts = [
            {name: _rounded(getattr(touch, name)) for name in ("start_mm", "direction")}
            | {"reading_mm": _rounded(touch.reading_mm), "residual_mm": _rounded(residual)}
            for touch, residual in residuals
        ]
        truth = None
        if error_mm is not None:
            truth = {"center_mm": _rounded(self.true_center_mm), "radius_mm": args.radius_mm}
            truth["error_mm"] = _rounded(error_mm)
        return {
            "package_version": package_version(),
            "simulated": args.arm is None,
            "arm": args.arm,
            "grip": self.grip,
            "method": {"search": args.search, "detector": args.detector},
            **center,
            "sigma_mm": _rounded(circle.sigma_mm),
            "covariance_mm2": circle.covariance_mm2.tolist(),
            "contacts": contacts,
            "travel": {
                "harmonics_mm": _rounded(self.travel.harmonics_mm),
                "sigma_mm": _rounded(self.travel.sigma_mm),
                "across_flats_mm": self.travel.across_flats_mm,
                "heading_rad": self.travel.heading_rad,
            },
            "truth": truth,
            "config": to_mapping(config),
            "assumed": list(self.assumed),
        }

    def write(self, document: Path, picture: Path) -> dict[str, str]:
        """Write document and picture; return their paths for the summary."""
        (x, y), sigma, radius = self.circle.center_mm, self.circle.sigma_mm, self.circle.radius_mm
        place = "simulated" if self.args.arm is None else f"arm at {self.args.arm}"
        title = (
            f"hole by touch ({place}): {self.args.search}, {len(self.touches)} contacts\n"
            f"centre ({x:.3f} ± {sigma[0]:.3f}, {y:.3f} ± {sigma[1]:.3f}) mm, "
            f"radius {radius:.3f} ± {sigma[2]:.3f} mm (one sigma)"
        )
        write_json(document, self.document())
        save_hole_plot(picture, title, self.picture)
        return {"output": str(document), "picture": str(picture)}


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
    found = AdaptiveSearch(prober, travel, args.searching).run(start_mm)
    return found.circle, found.touches


def _rounded(values: Any) -> Any:
    return np.round(values, DIGITS).tolist()
