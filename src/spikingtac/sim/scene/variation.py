"""Variation of a contact by the seed: place, heading, depth, extent, speed."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from spikingtac.sim.scene.motions import MotionConfig, SegmentConfig

FULL_TURN_DEG = 360.0


@dataclass(frozen=True, kw_only=True)
class VariationConfig:
    """Limits of the variation of a contact by the seed.

    Every value is the half-width of a uniform distribution, drawn anew for each contact. If all are
    zero every seed gives the same contact.

    Attributes:
        place_mm: Change of the start's x and of its y, mm.
        heading_deg: Turn of the whole path about its start, degrees.
        yaw_deg: Change of the indenter's own heading, degrees.
        depth_fraction: Relative change of all depths.
        extent_fraction: Relative change of slides, radii of circles and angles of twists.
        speed_fraction: Relative change of all speeds.
        pause_s: Longest additional pause before the contact, s (drawn from 0 upwards).
    """

    place_mm: float = 0.0
    heading_deg: float = 0.0
    yaw_deg: float = 0.0
    depth_fraction: float = 0.0
    extent_fraction: float = 0.0
    speed_fraction: float = 0.0
    pause_s: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            limit = 0.9 if field.name.endswith("_fraction") else math.inf
            if not 0 <= value <= limit:
                raise ValueError(f"{field.name} is {value}, valid are 0 to {limit}")


def vary(
    motion: MotionConfig, variation: VariationConfig, rng: np.random.Generator
) -> MotionConfig:
    """Return a motion with the variation of one contact of one seed.

    Args:
        motion: Motion of the scene file.
        variation: Limits of the variation.
        rng: Source of the draws; seven are taken in every case.
    """
    draw = rng.uniform(-1.0, 1.0, 7)
    heading_deg = float(variation.heading_deg * draw[2])
    depth = 1.0 + float(variation.depth_fraction * draw[4])
    extent = 1.0 + float(variation.extent_fraction * draw[5])
    speed = 1.0 + float(variation.speed_fraction * draw[6])
    segments = (
        _timed(_turned(_scaled(segment, depth, extent), heading_deg), speed)
        for segment in motion.segments
    )
    return replace(
        motion,
        x_mm=motion.x_mm + float(variation.place_mm * draw[0]),
        y_mm=motion.y_mm + float(variation.place_mm * draw[1]),
        yaw_deg=motion.yaw_deg + float(variation.yaw_deg * draw[3]),
        segments=tuple(segments),
    )


def _scaled(segment: SegmentConfig, depth: float, extent: float) -> SegmentConfig:
    factors = {"depth_mm": depth, "dx_mm": extent, "dy_mm": extent, "angle_deg": extent}
    if segment.kind == "circle":  # a roll's radius is its body's, not its path's
        factors["radius_mm"] = extent
    return replace(segment, **_times(segment, factors))


def _turned(segment: SegmentConfig, heading_deg: float) -> SegmentConfig:
    if heading_deg == 0.0:
        return segment
    if segment.kind == "circle":
        turned = ((segment.heading_deg or 0.0) + heading_deg) % FULL_TURN_DEG
        return replace(segment, heading_deg=turned)
    if segment.dx_mm is None and segment.dy_mm is None:
        return segment
    dx, dy = segment.dx_mm or 0.0, segment.dy_mm or 0.0
    cosine, sine = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    return replace(segment, dx_mm=cosine * dx - sine * dy, dy_mm=sine * dx + cosine * dy)


def _timed(segment: SegmentConfig, speed: float) -> SegmentConfig:
    factors = {"duration_s": 1.0 / speed, "speed_mm_s": speed, "speed_deg_s": speed}
    return replace(segment, **_times(segment, factors))


def _times(segment: SegmentConfig, factors: dict[str, float]) -> dict[str, float]:
    values = {name: getattr(segment, name) for name in factors}
    return {name: value * factors[name] for name, value in values.items() if value is not None}
