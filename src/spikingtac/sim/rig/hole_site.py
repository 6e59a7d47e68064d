"""A place to probe: the rig with a bit in its grip before a wall or a hole; its calibration.

The twin's arm reports without its repeatability error. A reading is the reported position plus
``sigma`` times a normal draw, which is stored with it; the same touch can thus be read again as an
arm of another repeatability would report it.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import ContactDetector
from spikingtac.errors import SearchError
from spikingtac.geometry.travel import TravelModel, fit_travel
from spikingtac.robot.arm import ArmState
from spikingtac.robot.prober import ArmProber, Prober, ProbingConfig, Touched
from spikingtac.sim.rig.probe import Grasp
from spikingtac.sim.rig.rig import Rig, SensingFinger
from spikingtac.sim.rig.ur3 import UR3Twin
from spikingtac.sim.rig.walls import HoleWall, NoWall, PlaneWall, Wall
from spikingtac.sim.scene import SkinConfig
from spikingtac.types import EventPacket, FloatArray

# Simulated length of the approach to a wall, mm; the longest run-up of a touch takes 0.2 mm of it.
SIMULATED_APPROACH_MM = 0.5
MARCH_TOLERANCE_MM = 1e-4  # Distance from the wall at which ray marching ends, mm.
MAX_DISTANCE_MM = 30.0  # Largest distance of a wall, mm. A wall farther away is ignored.
TILT_RAD = np.radians(1.0)  # Largest tilt of the plate (a part that lies on a table), rad.

OFFSET_FRACTION = 0.9  # Largest distance of the start from the centre over the free travel.
WARM_UP_US = 200_000  # Time after which the effect of the rod's start from rest has decayed, us.

# Case prefix -> repeatability of one reading per axis, mm (contract.md).
SIGMAS_MM = {"rep028": 0.028, "rep008": 0.008}
PLANNING_MM = SIGMAS_MM["rep028"]  # Repeatability of the readings on which the searches plan, mm.
CORNER_MM = 0.75 / math.sqrt(3.0)  # Largest radius of the hexagonal bit, 0.75 mm across flats, mm.
CROSS, DEFAULT = "cross", "default"
# How each search touches.
STYLES = {CROSS: ProbingConfig(), DEFAULT: ProbingConfig(conditions=True)}

# Directions of the calibration, degrees: those of the cross, and twelve evenly over the sector of
# the adaptive search, which are enough to fit travel and heading.
ANGLES_DEG = {
    CROSS: (0.0, 180.0, 90.0, 270.0),
    DEFAULT: (-17, -34, -51, 17, 34, 51, 163, 146, 129, 197, 214, 231),
}
WALL_MM = 1.0  # Distance of the calibration's wall from the bit, mm.
QUIET_WINDOWS = 4000  # Windows of the moving arm, 1 ms each, from which the detector learns.
SETTLE_WINDOWS = 100  # Windows after the start of that motion that are not used.
QUIET_SPEED_MM_S = 3.0  # Speed of the arm during the quiet windows, mm/s: that of the touches.


class HoleTrial(NamedTuple):
    """One hole of the plate, its true centre at the tip's height, and the start of the search."""

    wall: HoleWall
    center_mm: FloatArray
    start_mm: FloatArray


def hole_trial(radius_mm: float, center_mm: FloatArray, reach_mm: float, seed: int) -> HoleTrial:
    """Draw the tilt of the plate and a start within 0.9 of the bit's free travel.

    ``reach_mm`` is the largest radius of the bit. All holes of a seed have the same tilt.
    """
    plate = np.random.default_rng([seed, 2])
    tilt, heading = TILT_RAD * np.sqrt(plate.uniform()), plate.uniform(0.0, 2.0 * np.pi)
    slope = np.tan(tilt)
    axis = (float(slope * np.cos(heading)), float(slope * np.sin(heading)), 1.0)
    rng = np.random.default_rng([seed, 3, round(1000 * radius_mm)])
    away = OFFSET_FRACTION * (radius_mm - reach_mm) * np.sqrt(rng.uniform())
    angle = rng.uniform(0.0, 2.0 * np.pi)
    center = np.asarray(center_mm, np.float64)
    wall = HoleWall(radius_mm, (*center, 0.0), axis)
    start = center + away * np.array([np.cos(angle), np.sin(angle)])
    return HoleTrial(wall=wall, center_mm=center, start_mm=start)


class HoleSite:
    """The rig of the hole experiment: one sensing finger, a hexagonal bit, and walls.

    The second pad holds the bit as the first does, but it has no camera, which halves the computing
    time. The arm reports its pose without repeatability error.

    Args:
        grasp_seed: Seed of the grasp and of the sensor specimen.
        seed: Seed of noise, vibration and the phase of the arm's controller.

    Attributes:
        rig: Arm, probe, pad and camera.
        calibration: Calibration of the finger with the bit in the grip.
    """

    def __init__(self, grasp_seed: int, seed: int) -> None:
        finger = SensingFinger("typical", seed, serial=2 * grasp_seed + 1)
        rng = np.random.default_rng(seed)
        arm = UR3Twin(np.zeros(3), rng, repeatability_mm=0.0)
        self.rig = Rig(arm, NoWall(), finger, rng, grasp=Grasp.of(grasp_seed))
        image = self.rig.image
        self.calibration = Calibration(  # the true one, which a user has to learn
            reference_px=np.asarray(image.center_px, np.float64),
            radius_px=np.asarray(image.radius_px, np.float64),
            grid=SkinConfig().grid,
            size=finger.camera.size,
        )
        self.rig.advance(WARM_UP_US)

    def set_wall(self, wall: Wall, place_mm: FloatArray) -> None:
        """Place the probe in front of another wall; a bit that touches is released and swings."""
        self.rig.probe.contact.wall = NoWall()
        if self.rig.state.in_contact:
            self.rig.advance(WARM_UP_US)
        self.rig.relocate(np.array([*place_mm, 0.0]))
        self.rig.probe.contact.wall = wall
        self.rig.relocate(np.array([*place_mm, 0.0]))

    def free_travel(self, start_mm: FloatArray, direction: FloatArray) -> bool:
        """Skip the travel before the last stretch; see :data:`~spikingtac.robot.prober.FreeTravel`.

        Return False, without any change, where the probe touches the wall or would do so at the
        start.
        """
        start = np.array([*start_mm, 0.0])
        if self.rig.state.in_contact or self.rig.probe.contact.gap_mm(start) <= 0.0:
            return False
        contact, free_mm, heading = self.rig.probe.contact, 0.0, np.array([*direction, 0.0])
        # Ray marching; a wall that is farther away is none.
        while (gap := contact.gap_mm(start + free_mm * heading)) >= MARCH_TOLERANCE_MM:
            free_mm += gap
            if free_mm >= MAX_DISTANCE_MM:
                free_mm = 0.0
                break
        skipped_mm = max(free_mm - SIMULATED_APPROACH_MM, 0.0)
        self.rig.relocate(np.array([*(start_mm + skipped_mm * direction), 0.0]))
        return True


class RecordingProber:
    """A prober that adds the arm's repeatability to the readings, and stores readings and draws.

    ``stored`` holds the touches without repeatability, as JSON does, ``returned`` what the caller
    received, in the same order.
    """

    def __init__(self, prober: ArmProber, seed: Sequence[int]) -> None:
        self.stored: list[dict[str, Any]] = []
        self.returned: list[Touched] = []
        self._prober, self._rng = prober, np.random.default_rng(seed)

    def place_mm(self) -> FloatArray:
        """Return the position of the probe ``(2,)``, mm."""
        return self._prober.place_mm()

    def touch(self, start_mm: FloatArray, direction: FloatArray) -> Touched:
        """Touch, and return the reading with the repeatability :data:`PLANNING_MM`."""
        before = self._prober.touches
        touched = self._prober.touch(start_mm, direction)
        stored = {
            "start_mm": touched.start_mm.tolist(),
            "direction": touched.direction.tolist(),
            "reading_mm": touched.reading_mm.tolist(),
            "draw": self._rng.standard_normal(2).tolist(),
            "presses": self._prober.touches - before,
        }
        self.stored.append(stored)
        self.returned.append(touched_of(stored, PLANNING_MM))
        return self.returned[-1]

    def numbers(self, touches: Sequence[Touched]) -> list[int]:
        """Return the indices of some touches among the stored ones."""
        return [k for one in touches for k, other in enumerate(self.returned) if other is one]


def touched_of(stored: dict[str, Any], sigma_mm: float) -> Touched:
    """Return a stored touch as an arm with a repeatability of ``sigma_mm`` would report it."""
    reading = np.array(stored["reading_mm"]) + sigma_mm * np.array(stored["draw"])
    return Touched(np.array(stored["start_mm"]), np.array(stored["direction"]), reading)


def travel_of(stored: Sequence[dict[str, Any]], sigma_mm: float) -> TravelModel:
    """Fit the travel to stored touches of flat walls, read by an arm of this repeatability, mm."""
    touches = [touched_of(one, sigma_mm) for one in stored]
    excess = [float(touch.reading_mm @ touch.direction) - WALL_MM for touch in touches]
    angle = [float(np.arctan2(touch.direction[1], touch.direction[0])) for touch in touches]
    return fit_travel(np.array(angle), np.array(excess))


def touch_flat_walls(
    site: HoleSite,
    prober: Prober,
    style: str,
    cycles: int,
    before_cross: Callable[[], None] | None = None,
) -> None:
    """Touch a flat wall at :data:`WALL_MM`, ``cycles`` times in every direction that a style uses.

    The travel depends slightly on the previous direction. The directions therefore follow each
    other as in use: at random for the adaptive search, in a fixed order for the cross, before each
    of which ``before_cross`` makes an earlier contact.
    """
    for cycle in range(cycles):
        angles = np.radians(ANGLES_DEG[style])
        if style == DEFAULT:
            angles = np.random.default_rng(cycle).permutation(angles)
        elif before_cross is not None:
            before_cross()
        for angle in angles:
            touch_flat_wall(site, prober, angle)


def touch_flat_wall(site: HoleSite, prober: Prober, angle_rad: float) -> None:
    """Touch a flat wall at :data:`WALL_MM` in a direction; a touch may fail."""
    direction = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    toward = np.array([*direction, 0.0])
    site.set_wall(PlaneWall(WALL_MM * toward, -toward), np.zeros(2))
    with contextlib.suppress(SearchError):
        prober.touch(np.zeros(2), direction)


def prober_for(site: HoleSite, detector: ContactDetector, style: str) -> ArmProber:
    """Return a prober of the site that touches in one of the :data:`STYLES`."""
    arm, free = site.rig.arm, site.free_travel
    return ArmProber(arm, site.rig.windows(), detector, STYLES[style], free_travel=free)


def quiet_windows(site: HoleSite) -> list[tuple[EventPacket, ...]]:
    """Return :data:`QUIET_WINDOWS` windows of the arm that moves in free air."""
    here, windows = site.rig.arm.true_position_mm(), site.rig.windows()
    seconds = (QUIET_WINDOWS + 2 * SETTLE_WINDOWS) * 1e-3
    away_mm = np.array([QUIET_SPEED_MM_S * seconds, 0.0, 0.0])
    site.rig.arm.move_linear(here + away_mm, QUIET_SPEED_MM_S)
    for _ in range(SETTLE_WINDOWS):
        next(windows)
    quiet = [next(windows) for _ in range(QUIET_WINDOWS)]
    while site.rig.arm.state() is ArmState.MOVING:
        next(windows)
    return quiet
