"""A place to probe: the rig with a bit in its grip, and the wall that it stands at now."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.sim.rig.fingers import VIBRATION_MM, FingerConfig, SensingFinger
from spikingtac.sim.rig.pad_modes import PadConfig
from spikingtac.sim.rig.probe import ProbeConfig
from spikingtac.sim.rig.rig import Rig, RigConfig
from spikingtac.sim.rig.ur3 import UR3Config
from spikingtac.sim.rig.walls import HexBit, HoleWall, NoWall, PlaneWall, Wall
from spikingtac.types import EventPacket

Vector = NDArray[np.float64]

LISTENED_MM = 0.5
"""Free way before the wall that is simulated in full, mm; what lies before it is skipped. The
longest run-up of the searches' touches takes 0.2 mm of it."""
SHORT_MM = 1e-4
"""Steps towards a wall end when they are as short as this, mm."""
FAR_MM = 30.0
"""Farther walls are none, mm."""
TILT_RAD = np.radians(1.0)
"""Largest tilt of the plate (ours: a part that lies on a table)."""
OFFSET_SHARE = 0.9
"""Largest distance of the start from the centre, as a share of the bit's free travel."""
WARM_UP_US = 200_000
"""The rod forgets within this that it began at rest, us."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Grasp:
    """How the bit is held this time; drawn anew for each seed.

    Attributes:
        heading_rad: Direction of one of the bit's corners, rad.
        normal_ratio: Stiffness across the pads over that along them.
        tilt_ratio: The same for rotation out of the pads' plane.
        friction: Between bit and wall.
        serial: Of the sensor.
    """

    heading_rad: float
    normal_ratio: float
    tilt_ratio: float
    friction: float
    serial: int

    @classmethod
    def of(cls, seed: int) -> Grasp:
        """Draw a grasp (ours: ratios 0.8 to 1.5, friction 0.2 to 0.4, any heading)."""
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
    """One hole of the plate and where the search begins.

    Attributes:
        wall: The hole.
        center_mm: ``(2,)`` true centre at the tip's height, mm.
        start_mm: ``(2,)`` where the probe stands at first, mm.
    """

    wall: HoleWall
    center_mm: Vector
    start_mm: Vector


def hole_trial(radius_mm: float, center_mm: Vector, reach_mm: float, seed: int) -> HoleTrial:
    """Draw the tilt of the plate and a start within 0.9 of the bit's free travel.

    Args:
        radius_mm: Of the hole, mm.
        center_mm: ``(2,)`` on the plate, mm.
        reach_mm: Largest radius of the bit, mm.
        seed: Of tilt (the plate's) and start.
    """
    plate = np.random.default_rng([seed, 2])
    tilt, towards = TILT_RAD * np.sqrt(plate.uniform()), plate.uniform(0.0, 2.0 * np.pi)
    slope = np.tan(tilt)
    axis = (float(slope * np.cos(towards)), float(slope * np.sin(towards)), 1.0)
    rng = np.random.default_rng([seed, 3, round(1000 * radius_mm)])
    away = OFFSET_SHARE * (radius_mm - reach_mm) * np.sqrt(rng.uniform())
    angle = rng.uniform(0.0, 2.0 * np.pi)
    center = np.asarray(center_mm, np.float64)
    wall = HoleWall(
        center_mm=(float(center[0]), float(center[1]), 0.0), radius_mm=radius_mm, axis=axis
    )
    start = center + away * np.array([np.cos(angle), np.sin(angle)])
    return HoleTrial(wall=wall, center_mm=center, start_mm=start)


class HoleSite:
    """The rig of the hole experiment: one listening finger, a hexagonal bit, and walls.

    The second pad holds the bit as the first does, but nobody looks at it: half the computing time.
    The arm reports without its repeatability error, which is added to the readings by whoever takes
    them, so that arms of different repeatability share the touches.

    Args:
        grasp: How the bit is held.
        seed: Of noise, vibration and the arm's phase.
        preset: Of camera and vibration.

    Attributes:
        rig: Arm, probe, pad and camera.
    """

    def __init__(self, grasp: Grasp, seed: int, preset: str = "typical") -> None:
        probe = ProbeConfig(
            normal_ratio=grasp.normal_ratio,
            tilt_ratio=grasp.tilt_ratio,
            tip_friction=grasp.friction,
            bit=HexBit(heading_rad=grasp.heading_rad),
        )
        base = RigConfig(probe=probe, arm=UR3Config(repeatability_mm=0.0))
        config = replace(base, vibration=replace(base.vibration, rms_mm=VIBRATION_MM[preset]))
        finger = SensingFinger(FingerConfig(camera=preset, serial=grasp.serial), seed)
        rng = np.random.default_rng(seed)
        self.rig = Rig(config, NoWall(), [finger], np.zeros(3), rng)
        self.calibration = _calibration(finger, self.rig)
        self.rig.advance(WARM_UP_US)

    def windows(self) -> Iterator[tuple[EventPacket, ...]]:
        """Yield the windows of the listening finger, for ever."""
        return self.rig.paired_windows()

    def face(self, wall: Wall, place_mm: Vector) -> None:
        """Stand at a place ``(2,)`` in front of another wall, in free air.

        A bit that still leans on the wall before is lifted off it, and swings.
        """
        self.rig.probe.contact.wall = NoWall()
        if self.rig.state.in_contact:
            self.rig.advance(WARM_UP_US)
        self.rig.carry(np.array([*place_mm, 0.0]))
        self.rig.probe.contact.wall = wall
        self.rig.carry(np.array([*place_mm, 0.0]))

    def free_travel(self, start_mm: Vector, direction: Vector) -> bool:
        """Skip what lies before the last stretch; see :data:`~spikingtac.robot.prober.FreeTravel`.

        Nothing is skipped where the probe does not hang free, or the start is not in free air.
        """
        start = np.array([*start_mm, 0.0])
        if self.rig.state.in_contact or self.rig.probe.contact.gap_mm(start) <= 0.0:
            return False
        ahead = max(self._free_way_mm(start_mm, direction) - LISTENED_MM, 0.0)
        self.rig.carry(np.array([*(start_mm + ahead * direction), 0.0]))
        return True

    def _free_way_mm(self, start_mm: Vector, direction: Vector) -> float:
        """Return the way from a place to the wall, by steps as long as the distance to it."""
        way, towards = 0.0, np.array([*direction, 0.0])
        start = np.array([*start_mm, 0.0])
        while way < FAR_MM:
            gap = self.rig.probe.contact.gap_mm(start + way * towards)
            if gap < SHORT_MM:
                return way
            way += min(gap, FAR_MM)
        return 0.0


def flat_wall(direction: Vector, distance_mm: float) -> PlaneWall:
    """Return a wall across a direction ``(2,)`` at a distance from the origin."""
    x, y = direction
    return PlaneWall(
        point_mm=(float(distance_mm * x), float(distance_mm * y), 0.0),
        normal=(-float(x), -float(y), 0.0),
    )


def _calibration(finger: SensingFinger, rig: Rig) -> Calibration:
    """Return where the markers rest with the bit in the grip (known here; learnt by a user)."""
    image = finger.look(rig.skin())
    return Calibration(
        reference_px=np.asarray(image.center_px, np.float64),
        radius_px=np.asarray(image.radius_px, np.float64),
        grid=PadConfig().skin.grid,
        size=finger.camera.size,
    )
