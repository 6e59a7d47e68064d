"""How a sensor's discs look at rest: their edges, the steps of the events, the levels across."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
LARGEST_STEP = 0.5
"""Share of the full swing of an event above which an edge hardly swings (ours)."""


def why_no_growth(calibration: Calibration) -> str | None:
    """Return why growth cannot be told with a calibration; None where it can."""
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
    return None


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
            raise ConfigError(f"the growth of the discs cannot be told: {why}")
        count, (width, height) = len(calibration.reference_px), calibration.size
        contrast = _each(calibration.marker_contrast, calibration.contrast, count)
        edge_px = _each(calibration.marker_edge_px, calibration.edge_px, count)
        radius_px = np.asarray(calibration.radius_px, np.float64)
        away = np.arange(0.0, float(radius_px.max()) + PROFILE_REACH_PX, PROFILE_STEP_PX)
        offsets = [_offset_px(c, e) for c, e in zip(contrast, edge_px, strict=True)]
        return cls(
            radius_px,
            np.array(offsets),
            edge_level(away - radius_px[:, None], contrast[:, None], edge_px[:, None]),
            (
                _filled(calibration.step_on_map, calibration.step_on, (height, width)),
                _filled(calibration.step_off_map, calibration.step_off, (height, width)),
            ),
        )


def edge_level(outside_px: Field, contrast: Field | float, edge_px: Field | float) -> Field:
    """Return the level across a blurred edge as events see it: 1 in the disc, 0 on the ground.

    Args:
        outside_px: Distance from the nominal rim, px, negative inside.
        contrast: Brighter over darker intensity; a dark marker's may be given either way.
        edge_px: Logistic scale of the intensity, px.
    """
    ratio = np.maximum(contrast, 1.0 / np.asarray(contrast))
    inside = 1.0 / (1.0 + np.exp(np.clip(outside_px / edge_px, -40.0, 40.0)))
    return np.asarray(np.log1p((ratio - 1.0) * inside) / np.log(ratio), np.float64)


def _offset_px(contrast: float, edge_px: float) -> float:
    away, width = np.linspace(-OFFSET_EDGES, OFFSET_EDGES, OFFSET_POINTS, retstep=True)
    level = edge_level(away, contrast, 1.0)
    return float((level - (away < 0.0)).sum() * width * edge_px)


def _each(own: Field | None, common: float | None, count: int) -> Field:
    return np.full(count, common, np.float64) if own is None else np.asarray(own, np.float64)


def _filled(own: Levels | None, common: float | None, shape: tuple[int, int]) -> Levels:
    steps = np.full(shape, common, np.float32)
    return steps if own is None else np.where(own > 0.0, own, steps).astype(np.float32)
