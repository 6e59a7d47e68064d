"""Calibration of detector and travel on the twin: quiet windows, and touches of a flat wall."""

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
from spikingtac.robot.prober import ArmProber, Prober, ProbingConfig
from spikingtac.sim.probing.readings import touched_of
from spikingtac.sim.rig.hole_site import HoleSite, flat_wall
from spikingtac.types import EventPacket

CORNER_MM = 0.75 / math.sqrt(3.0)
"""Largest radius of the hexagonal bit, 0.75 mm across flats, mm."""
CROSS, DEFAULT = "cross", "default"
STYLES = {CROSS: ProbingConfig(), DEFAULT: ProbingConfig.conditioned()}
"""How each search touches."""
ANGLES_DEG = {
    CROSS: (0.0, 180.0, 90.0, 270.0),
    DEFAULT: tuple(
        way + side * step for way in (0, 180) for side in (-1, 1) for step in (17, 34, 51)
    ),
}
"""Directions of the calibration, degrees: those of the cross, and twelve evenly over the sector of
the adaptive search, which are enough to fit travel and heading."""
WALL_MM = 1.0
"""Distance of the calibration's wall from the bit, mm."""
QUIET_WINDOWS = 4000
"""Windows of the moving arm, 1 ms each, from which the detector learns."""
SETTLE_WINDOWS = 100
"""Windows after the start of that motion that are not used."""
QUIET_SPEED_MM_S = 3.0
"""Speed of the arm during the quiet windows, mm/s: that of the touches."""


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
