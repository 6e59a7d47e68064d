"""A place to probe: the rig with a bit in its grip, in front of a wall or a hole."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.sim.rig.probe import ProbeConfig
from spikingtac.sim.rig.rig import VIBRATION_MM, FingerConfig, Rig, RigConfig, SensingFinger
from spikingtac.sim.rig.ur3 import UR3Config
from spikingtac.sim.rig.walls import HexBit, HoleWall, NoWall, PlaneWall, Wall
from spikingtac.sim.scene import SkinConfig
from spikingtac.types import EventPacket

# Length of the approach to the wall that is simulated, mm; what lies before it is skipped. The
# longest run-up of the searches' touches takes 0.2 mm of it.
SIMULATED_APPROACH_MM = 0.5
MARCH_TOLERANCE_MM = 1e-4  # Distance from the wall at which ray marching ends, mm.
MAX_DISTANCE_MM = 30.0  # Largest distance of a wall, mm. A wall farther away is ignored.
TILT_RAD = np.radians(1.0)  # Largest tilt of the plate (a part that lies on a table), rad.

# Largest distance of the start from the centre, as a fraction of the bit's free travel.
OFFSET_FRACTION = 0.9
WARM_UP_US = 200_000  # Time after which the effect of the rod's start from rest has decayed, us.


@dataclass(frozen=True, kw_only=True, slots=True)
class Grasp:
    """Properties of one grasp of the bit, drawn anew for each seed.

    Attributes:
        heading_rad: Direction of one of the bit's corners, rad.
        normal_ratio: Stiffness across the pads divided by that along them.
        tilt_ratio: The same for rotation out of the pads' plane.
        friction: Coefficient of friction between bit and wall.
        serial: Number of the individual sensor.
    """

    heading_rad: float
    normal_ratio: float
    tilt_ratio: float
    friction: float
    serial: int

    @classmethod
    def of(cls, seed: int) -> Grasp:
        """Draw a grasp (assumed: ratios 0.8 to 1.5, friction 0.2 to 0.4, any heading)."""
        rng = np.random.default_rng([seed, 1])
        return cls(
            heading_rad=float(rng.uniform(0.0, np.pi / 3)),
            normal_ratio=float(rng.uniform(0.8, 1.5)),
            tilt_ratio=float(rng.uniform(0.8, 1.5)),
            friction=float(rng.uniform(0.2, 0.4)),
            serial=2 * seed + 1,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class HoleTrial:
    """One hole of the plate and the start of the search.

    Attributes:
        wall: The hole.
        center_mm: ``(2,)`` true centre at the tip's height, mm.
        start_mm: ``(2,)`` first position of the probe, mm.
    """

    wall: HoleWall
    center_mm: FloatArray
    start_mm: FloatArray


def hole_trial(radius_mm: float, center_mm: FloatArray, reach_mm: float, seed: int) -> HoleTrial:
    """Draw the tilt of the plate and a start within 0.9 of the bit's free travel.

    Args:
        radius_mm: Radius of the hole, mm.
        center_mm: ``(2,)`` centre on the plate, mm.
        reach_mm: Largest radius of the bit, mm.
        seed: Seed of the tilt (the same for all holes of a plate) and of the start.
    """
    plate = np.random.default_rng([seed, 2])
    tilt, heading = TILT_RAD * np.sqrt(plate.uniform()), plate.uniform(0.0, 2.0 * np.pi)
    slope = np.tan(tilt)
    axis = (float(slope * np.cos(heading)), float(slope * np.sin(heading)), 1.0)
    rng = np.random.default_rng([seed, 3, round(1000 * radius_mm)])
    away = OFFSET_FRACTION * (radius_mm - reach_mm) * np.sqrt(rng.uniform())
    angle = rng.uniform(0.0, 2.0 * np.pi)
    center = np.asarray(center_mm, np.float64)
    wall = HoleWall(
        center_mm=(float(center[0]), float(center[1]), 0.0), radius_mm=radius_mm, axis=axis
    )
    start = center + away * np.array([np.cos(angle), np.sin(angle)])
    return HoleTrial(wall=wall, center_mm=center, start_mm=start)


class HoleSite:
    """The rig of the hole experiment: one sensing finger, a hexagonal bit, and walls.

    The second pad holds the bit as the first does, but it has no camera, which halves the computing
    time. The arm reports its pose without repeatability error. The caller adds that error to the
    readings, so that arms of different repeatability use the same touches.

    Args:
        grasp: Properties of the grasp.
        seed: Seed of noise, vibration and the phase of the arm's controller.
        preset: Preset of camera and vibration.

    Attributes:
        rig: Arm, probe, pad and camera.
        calibration: Calibration of the finger with the bit in the grip.
    """

    def __init__(self, grasp: Grasp, seed: int, preset: str = "typical") -> None:
        probe = ProbeConfig(
            normal_ratio=grasp.normal_ratio,
            tilt_ratio=grasp.tilt_ratio,
            tip_friction=grasp.friction,
            bit=HexBit(heading_rad=grasp.heading_rad),
        )
        arm = UR3Config(repeatability_mm=0.0)
        config = RigConfig(probe=probe, arm=arm, vibration_mm=VIBRATION_MM[preset])
        finger = SensingFinger(FingerConfig(camera=preset, serial=grasp.serial), seed)
        rng = np.random.default_rng(seed)
        self.rig = Rig(config, NoWall(), [finger], np.zeros(3), rng)
        image = finger.project(self.rig.skin())
        self.calibration = Calibration(  # the true one, which a user has to learn
            reference_px=np.asarray(image.center_px, np.float64),
            radius_px=np.asarray(image.radius_px, np.float64),
            grid=SkinConfig().grid,
            size=finger.camera.size,
        )
        self.rig.advance(WARM_UP_US)

    def windows(self) -> Iterator[tuple[EventPacket, ...]]:
        """Yield the windows of the finger without end."""
        return self.rig.paired_windows()

    def set_wall(self, wall: Wall, place_mm: FloatArray) -> None:
        """Place the probe at ``(2,)`` in front of another wall, in free air.

        If the bit still touches the previous wall it is released first and swings.

        Args:
            wall: The new wall.
            place_mm: ``(2,)`` position of the probe, mm.
        """
        self.rig.probe.contact.wall = NoWall()
        if self.rig.state.in_contact:
            self.rig.advance(WARM_UP_US)
        self.rig.relocate(np.array([*place_mm, 0.0]))
        self.rig.probe.contact.wall = wall
        self.rig.relocate(np.array([*place_mm, 0.0]))

    def free_travel(self, start_mm: FloatArray, direction: FloatArray) -> bool:
        """Skip the travel before the last stretch; see :data:`~spikingtac.robot.prober.FreeTravel`.

        Args:
            start_mm: ``(2,)`` start of the travel, mm.
            direction: ``(2,)`` unit vector of the travel.

        Returns:
            False if nothing is skipped, because the probe touches the wall or the start is not in
            free air.
        """
        start = np.array([*start_mm, 0.0])
        if self.rig.state.in_contact or self.rig.probe.contact.gap_mm(start) <= 0.0:
            return False
        contact, free_mm, heading = self.rig.probe.contact, 0.0, np.array([*direction, 0.0])
        while free_mm < MAX_DISTANCE_MM:  # ray marching; a wall that is farther away is none
            gap = contact.gap_mm(start + free_mm * heading)
            if gap < MARCH_TOLERANCE_MM:
                break
            free_mm += min(gap, MAX_DISTANCE_MM)
        else:
            free_mm = 0.0
        skipped_mm = max(free_mm - SIMULATED_APPROACH_MM, 0.0)
        self.rig.relocate(np.array([*(start_mm + skipped_mm * direction), 0.0]))
        return True


def flat_wall(direction: FloatArray, distance_mm: float) -> PlaneWall:
    """Return a wall across a direction ``(2,)`` at a distance from the origin."""
    x, y = direction
    return PlaneWall(
        point_mm=(float(distance_mm * x), float(distance_mm * y), 0.0),
        normal=(-float(x), -float(y), 0.0),
    )
