"""Probing on the twin: calibration on a flat wall, and readings of arms of any repeatability.

The twin's arm reports without its repeatability error. A reading is the reported position plus
``sigma`` times a normal draw, which is stored with it; the same touch can thus be read again as an
arm of another repeatability would report it.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.errors import SearchError
from spikingtac.geometry.travel import TravelModel, fit_travel
from spikingtac.robot.arm import ArmState
from spikingtac.robot.prober import ArmProber, Prober, ProbingConfig, Touched
from spikingtac.sim.rig.hole_site import HoleSite, flat_wall
from spikingtac.types import EventPacket, FloatArray

# Case prefix -> repeatability of one reading per axis, mm (contract.md).
SIGMAS_MM = {"rep028": 0.028, "rep008": 0.008}
PLANNING_MM = SIGMAS_MM["rep028"]  # Repeatability of the readings on which the searches plan, mm.
CORNER_MM = 0.75 / math.sqrt(3.0)  # Largest radius of the hexagonal bit, 0.75 mm across flats, mm.
CROSS, DEFAULT = "cross", "default"
STYLES = {CROSS: ProbingConfig(), DEFAULT: ProbingConfig.conditioned()}  # How each search touches.

# Directions of the calibration, degrees: those of the cross, and twelve evenly over the sector of
# the adaptive search, which are enough to fit travel and heading.
ANGLES_DEG = {
    CROSS: (0.0, 180.0, 90.0, 270.0),
    DEFAULT: tuple(
        way + side * step for way in (0, 180) for side in (-1, 1) for step in (17, 34, 51)
    ),
}
WALL_MM = 1.0  # Distance of the calibration's wall from the bit, mm.
QUIET_WINDOWS = 4000  # Windows of the moving arm, 1 ms each, from which the detector learns.
SETTLE_WINDOWS = 100  # Windows after the start of that motion that are not used.
QUIET_SPEED_MM_S = 3.0  # Speed of the arm during the quiet windows, mm/s: that of the touches.


class RecordingProber:
    """A prober that adds the arm's repeatability to the readings, and stores readings and draws.

    Args:
        prober: Makes the touches.
        seed: Seed of the draws.

    Attributes:
        stored: The touches without repeatability, as JSON holds them.
        returned: The touches that the caller received, in the same order.
    """

    def __init__(self, prober: ArmProber, seed: Sequence[int]) -> None:
        self.stored: list[dict[str, Any]] = []
        self.returned: list[Touched] = []
        self._prober = prober
        self._rng = np.random.default_rng(seed)

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
    """Fit the travel to stored touches of flat walls at :data:`WALL_MM`.

    Args:
        stored: Touches, from ``RecordingProber.stored``.
        sigma_mm: Repeatability of the arm per axis, mm.
    """
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
    """Touch a flat wall at :data:`WALL_MM` in every direction that a style uses.

    The travel depends slightly on the previous direction. The directions therefore follow each
    other as in use: at random for the adaptive search, in a fixed order for the cross.

    Args:
        site: The site; its wall is replaced for each touch.
        prober: Makes the touches.
        style: One of :data:`STYLES`.
        cycles: Number of touches in each direction.
        before_cross: Is called before each cross, to make an earlier contact.
    """
    for cycle in range(cycles):
        angles = np.radians(ANGLES_DEG[style])
        if style == DEFAULT:
            angles = np.random.default_rng(cycle).permutation(angles)
        elif before_cross is not None:
            before_cross()
        for angle in angles:
            direction = np.array([np.cos(angle), np.sin(angle)])
            site.set_wall(flat_wall(direction, WALL_MM), np.zeros(2))
            with contextlib.suppress(SearchError):  # a failed touch is left out of the fit
                prober.touch(np.zeros(2), direction)


def prober_for(site: HoleSite, detector: ContactDetector, style: str) -> ArmProber:
    """Return a prober of the site that touches in one of the :data:`STYLES`."""
    return ArmProber(
        site.rig.arm, site.windows(), detector, STYLES[style], free_travel=site.free_travel
    )


def detector_for(
    site: HoleSite, name: str, quiet: Sequence[tuple[EventPacket, ...]]
) -> ContactDetector:
    """Return a contact detector for the site's finger."""
    return make_detector(name, DetectionConfig(), [site.calibration], quiet)


def quiet_windows(site: HoleSite) -> list[tuple[EventPacket, ...]]:
    """Return :data:`QUIET_WINDOWS` windows of the arm that moves in free air."""
    here = site.rig.arm.true_position_mm()
    windows = site.windows()
    seconds = (QUIET_WINDOWS + 2 * SETTLE_WINDOWS) * 1e-3
    away_mm = np.array([QUIET_SPEED_MM_S * seconds, 0.0, 0.0])
    site.rig.arm.move_linear(here + away_mm, QUIET_SPEED_MM_S)
    for _ in range(SETTLE_WINDOWS):
        next(windows)
    quiet = [next(windows) for _ in range(QUIET_WINDOWS)]
    while site.rig.arm.state() is ArmState.MOVING:
        next(windows)
    return quiet
