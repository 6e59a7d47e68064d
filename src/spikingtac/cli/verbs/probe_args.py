"""The options of ``spikingtac probe``, and what a search of the twin or of an arm returns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import tyro

import spikingtac as st
from spikingtac.cli.options import WriteArgs
from spikingtac.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Find centre and radius of one hole by touch; on the twin unless an arm is given.

    The probe must stand in the hole. This is not a safety function: it does not replace the robot's
    protective stop.

    Attributes:
        output: Folder for hole.json and hole.png; nothing is written unless given.
        arm: Address of a UR arm in remote control; the twin is used unless given.
        events: With --arm: the finger's camera, a named pipe; a recording only with --rehearsal.
        rehearsal: With --arm: allow --events to be a recording. The arm then moves by what was felt
            earlier, and feels nothing: no contact stops it.
        calibration: With --arm: calibration.json of that finger.
        gripper: With --arm: close its Robotiq gripper on the probe before the search, and report
            the grip.
        release: With --gripper: open the gripper after the search.
        travel_mm: With --arm: delta_crit, the tip's travel from touch to decision, mm, from a known
            wall.
        travel_sigma_mm: With --arm: standard deviation of this travel from touch to touch, mm.
        radius_mm: On the twin: true radius of the hole, mm.
        seed: On the twin: seed of everything random.
        search: default (adaptive) or cross4 (the paper's four contacts).
        contacts: Largest number of contacts of the adaptive search.
        center_sigma_mm: The adaptive search ends at this standard deviation of the centre along
            each axis, mm.
        travel_limit_mm: Largest travel of one approach, mm; a hole must be smaller.
        force_limit_n: Largest force of the tip, N, even if no wall is detected; it limits the
            travel.
        detector: Contact detector: default (signed, sequential) or event_count (as published).
    """

    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = None
    arm: str | None = None
    events: Path | None = None
    rehearsal: bool = False
    calibration: Path | None = None
    gripper: bool = False
    release: bool = False
    travel_mm: float = 0.12
    travel_sigma_mm: float = 0.03
    radius_mm: float = 2.0
    seed: int = 0
    search: Literal["default", "cross4"] = "default"
    contacts: int = 12
    center_sigma_mm: float = 0.0
    travel_limit_mm: float = 11.0
    force_limit_n: float = 0.5
    detector: Annotated[str, tyro.conf.arg(metavar="default|event_count")] = "default"

    def probing(self) -> st.ProbingConfig:
        """Return how the search touches."""
        limits = {"travel_limit_mm": self.travel_limit_mm, "force_limit_n": self.force_limit_n}
        return st.ProbingConfig(conditions=self.search == "default", **limits)

    def searching(self) -> dict[str, Any]:
        """Return the settings of the adaptive search."""
        return {"contacts": self.contacts, "center_sigma_mm": self.center_sigma_mm}


class ProbedHole(NamedTuple):
    """The estimate of a hole, with the search that led to it.

    Attributes:
        found: The estimate and its contacts.
        travel: The travel by which the readings were corrected.
        assumed: The assumptions, in sentences.
        given: What the search depended on beside its settings.
        true_center_mm: ``(2,)`` the hole's centre, where it is known, mm.
        grip: How the gripper holds the probe; None without a gripper.
    """

    found: st.FoundHole
    travel: st.TravelModel
    assumed: tuple[str, ...]
    given: dict[str, Any]
    true_center_mm: FloatArray | None = None
    grip: dict[str, Any] | None = None
