"""The scene of the collision experiment, and the geometry of an approach."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from spikingtac import Calibration
from spikingtac.config import digest
from spikingtac.schema import to_mapping
from spikingtac.sim import (
    ACCELERATION_MM_S2,
    REPEATABILITY_MM,
    SERVO_LAG_S,
    VIBRATION_MM,
    Bit,
    Grasp,
    OpticsConfig,
    PlaneWall,
    Rig,
    SensingFinger,
    SkinConfig,
    UR3Twin,
    grip_camera,
)
from spikingtac.types import FloatArray
from spikingtac_paper.free_motion.free_rig import FreeRig

# Direction of the approach in the base frame: along the pads, across the rod.
DIRECTION: FloatArray = np.array([1.0, 0.0, 0.0])
NEAR_MM = 0.5  # Distance from the wall at which the arm stands before its first touch, mm.

# Windows at constant speed before the detectors listen: the rod's oscillation has decayed to a
# fifth by then.
SETTLE_WINDOWS = 100
MARGIN_S = 0.04  # Largest delay of the constant speed by report, cycle, network and servo, s.

# The touch before an approach: travel of the arm beyond the first touch, mm (a typical overshoot),
# speed of approach and return, mm/s, and time for which the probe presses, s.
PRIOR_TOUCH = {"press_mm": 1.0, "speed_mm_s": 20.0, "hold_s": 0.2}
RELEASED_S = 1.0  # Time from the release of one touch to the next touch, s (contract.md).


@dataclass(frozen=True, kw_only=True, slots=True)
class CollisionScene:
    """The scene that contract.md fixes: an arm with a probe between two pads, before a wall.

    Attributes:
        preset: ``typical`` or ``noisy``: camera and vibration.
        serial: Serial number of the sensor specimen.
    """

    preset: str = "typical"
    serial: int = 1

    @property
    def vibration_mm(self) -> float:
        """Root mean square of the arm's vibration per axis, mm."""
        return VIBRATION_MM[self.preset]

    def make_rig(self, seed: int) -> Rig:
        """Return the whole twin, the tip :data:`NEAR_MM` before the wall."""
        way = DIRECTION
        wall = PlaneWall(way * Bit().radius_mm, -way)
        finger = SensingFinger(self.preset, seed, serial=self.serial)
        rng = np.random.default_rng(seed)
        arm = UR3Twin(-NEAR_MM * way, rng)
        return Rig(arm, wall, finger, rng, vibration_mm=self.vibration_mm)

    def make_free_rig(self, seed: int, history: Literal["rested", "random"]) -> FreeRig:
        """Return the fast path of the same sensor and probe, without a wall."""
        return FreeRig(self.preset, seed, history=history, serial=self.serial)

    def calibration(self, reference_px: ArrayLike, radius_px: ArrayLike) -> Calibration:
        """Return the calibration with these rest positions and radii, px."""
        return Calibration(
            reference_px=np.array(reference_px),
            radius_px=np.array(radius_px),
            grid=SkinConfig().grid,
            size=OpticsConfig().size,
        )

    def resolved(self) -> dict[str, Any]:
        """Return every value of the scene, with those of the camera's preset."""
        return {
            "scene": to_mapping(self),
            "rig": {
                "probe": to_mapping(Grasp()),
                "vibration_mm": self.vibration_mm,
                "repeatability_mm": REPEATABILITY_MM,
            },
            "camera": to_mapping(grip_camera(self.preset)),
            "optics": to_mapping(OpticsConfig()),
            "past": {"touch": PRIOR_TOUCH, "released_s": RELEASED_S},
        }

    def digest(self) -> str:
        """Return the digest of :meth:`resolved`."""
        return digest(self.resolved())


def run_up_mm(speed_mm_s: float) -> float:
    """Return the distance from start to wall in which the probe's oscillation decays, mm."""
    braking = speed_mm_s**2 / (2.0 * ACCELERATION_MM_S2)
    ramp = speed_mm_s * math.sqrt(speed_mm_s / UR3Twin.JERK_MM_S3)
    listening = speed_mm_s * (SETTLE_WINDOWS * 1e-3 + MARGIN_S)
    return NEAR_MM + braking + ramp + listening


def travel_time_s(speed_mm_s: float, way_mm: float) -> float:
    """Return the time from a command until the arm has travelled a distance, s."""
    jerk = UR3Twin.JERK_MM_S3
    late_s = UR3Twin.NETWORK_S + 0.5 * UR3Twin.CYCLE_S + float(np.mean(SERVO_LAG_S))
    ramp_s = min(ACCELERATION_MM_S2 / jerk, math.sqrt(speed_mm_s / jerk))
    return late_s + way_mm / speed_mm_s + 0.5 * (speed_mm_s / ACCELERATION_MM_S2 + ramp_s)
