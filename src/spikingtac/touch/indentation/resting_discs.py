"""How a sensor's discs look at rest: their edges, the steps of the events, the levels across."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile, disc_profiles
from spikingtac.calibration.pitch import FEWEST_MARKERS, marker_pitch_px
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.touch.indentation.disc_areas import PROFILE_STEP_PX

Field = NDArray[np.float64]
Levels = NDArray[np.float32]

NEEDED = ("contrast", "edge_px", "step_on", "step_off")
"""What a calibration must know of the discs; one that was written by hand may not."""
PROFILE_REACH_PX = 12.0
"""How far outside of the resting rim the levels are tabulated, px: farther than any disc grows."""
OFFSET_EDGES, OFFSET_POINTS = 20.0, 2001
"""Half the way across an edge over which its level is summed, in edge scales, and its points."""
LEAST_GAP_PX = 3.0
"""Ground between the edges of two neighbours below which growth is not told, px (ours: discs of
7 px that shift by 4 and grow by 0.1 read 0.092 to 0.098 at 3 px, 0.077 to 0.092 at 2; those that
grow by 0.2 touch at 2.8)."""
LARGEST_STEP = 0.5
"""Share of the full swing of an event above which an edge hardly swings (ours)."""


def why_no_growth(calibration: Calibration) -> str | None:
    """Return why growth cannot be measured with a calibration; None where it can."""
    lacking = [name for name in NEEDED if getattr(calibration, name) is None]
    if lacking:
        return (
            f"the calibration lacks {', '.join(lacking)}, so the full swing of an edge is unknown; "
            "make one with: spikingtac calibrate"
        )
    step = max(calibration.step_on or 0.0, calibration.step_off or 0.0)
    if step > LARGEST_STEP:
        return (
            f"an event stands for {100 * step:.0f} % of the full swing, fewer than two for "
            "an edge; lower the camera's thresholds or give it more light, and calibrate again"
        )
    if calibration.recovery_s is not None:
        return (
            "the pixels of this sensor forget light that they lose without an event, so the sum of "
            "their events is not the size of a disc"
        )
    gap_px = _gap_px(calibration)
    if gap_px < LEAST_GAP_PX:
        return (
            f"the edges of neighbouring discs are {gap_px:.1f} px apart, fewer than "
            f"{LEAST_GAP_PX:g}: discs that grow would merge; bring the camera nearer, or take "
            "smaller discs"
        )
    return None


def _gap_px(calibration: Calibration) -> float:
    """Return the ground between the edges of neighbouring discs, px; infinite for a single one."""
    if len(calibration.reference_px) < FEWEST_MARKERS:
        return float("inf")
    radius_px = float(np.median(calibration.radius_px))
    return marker_pitch_px(calibration.reference_px) - 2.0 * radius_px


@dataclass(frozen=True, slots=True)
class RestingDiscs:
    """The discs of one sensor at rest.

    Attributes:
        radius_px: ``(m,)`` radii, px.
        offset_px: ``(m,)`` how far outside of the radius the edge of a sharp disc with the same sum
            of levels would lie, px: events follow the logarithm of a blurred edge.
        profiles: ``(m, k)`` levels at distances of 0, 0.25, 0.5 ... px from the centre.
        steps: ``(height, width)`` shares of the full swing of an ON event, and of an OFF event.
    """

    radius_px: Field
    offset_px: Field
    profiles: Field
    steps: tuple[Levels, Levels]

    @classmethod
    def of(cls, calibration: Calibration) -> RestingDiscs:
        """Return the discs that a calibration describes.

        Raises:
            ConfigError: It knows no contrast, edge or steps, or an edge gives hardly an event.
        """
        why = why_no_growth(calibration)
        if why is not None:
            raise ConfigError(f"the growth of the discs cannot be measured: {why}")
        width, height = calibration.size
        discs = disc_profiles(calibration)
        radius_px = np.asarray(calibration.radius_px, np.float64)
        away = np.arange(0.0, float(radius_px.max()) + PROFILE_REACH_PX, PROFILE_STEP_PX)
        levels = [disc.level(away - radius) for disc, radius in zip(discs, radius_px, strict=True)]
        return cls(
            radius_px,
            np.array([_offset_px(disc) for disc in discs]),
            np.array(levels),
            (
                _filled(calibration.step_on_map, calibration.step_on, (height, width)),
                _filled(calibration.step_off_map, calibration.step_off, (height, width)),
            ),
        )


def _offset_px(disc: DiscProfile) -> float:
    half_px = OFFSET_EDGES * disc.edge_px
    away, width = np.linspace(-half_px, half_px, OFFSET_POINTS, retstep=True)
    return float((disc.level(away) - (away < 0.0)).sum() * width)


def _filled(own: Levels | None, common: float | None, shape: tuple[int, int]) -> Levels:
    steps = np.full(shape, common, np.float32)
    return steps if own is None else np.where(own > 0.0, own, steps).astype(np.float32)
