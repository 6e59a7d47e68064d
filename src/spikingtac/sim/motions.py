"""Motion of an indenter: timed segments from approach to release, and its pose at any time.

Positions are mm in the skin's frame (x right, y down). The third coordinate is the depth of the
indenter's deepest point: positive inside the gel, negative above it. Every segment starts and ends
at rest.
"""

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from spikingtac.schema import require_within
from spikingtac.types import FloatArray, Pose

SegmentKind = Literal["hold", "press", "lift", "release", "slide", "rub", "twist", "circle", "roll"]
Profile = Literal["minimum_jerk", "trapezoid"]

# Kind -> fields that it needs, and fields that it may have besides its duration and profile.
_FIELDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "hold": ((), ()),
    "press": (("depth_mm",), ("speed_mm_s",)),
    "lift": ((), ("height_mm", "speed_mm_s")),
    "release": ((), ("height_mm", "speed_mm_s")),
    "slide": ((), ("dx_mm", "dy_mm", "depth_mm", "speed_mm_s")),
    "rub": (("repeats",), ("dx_mm", "dy_mm", "speed_mm_s")),
    "twist": (("angle_deg",), ("depth_mm", "speed_deg_s")),
    "circle": (("radius_mm", "turns"), ("heading_deg", "speed_mm_s")),
    "roll": (("radius_mm",), ("dx_mm", "dy_mm", "speed_mm_s")),
}
_TIMING = ("duration_s", "speed_mm_s", "speed_deg_s")
_LIMITS = {
    **{"duration_s": (1e-6, 1e5), "speed_mm_s": (1e-3, 1e5), "speed_deg_s": (1e-3, 1e6)},
    **{"radius_mm": (1e-3, 1e3), "repeats": (1, 10_000), "turns": (-1e4, 1e4)},
    **dict.fromkeys(("dx_mm", "dy_mm", "depth_mm", "height_mm"), (-1e3, 1e3)),
    **dict.fromkeys(("angle_deg", "heading_deg"), (-1e5, 1e5)),
}


@dataclass(frozen=True, kw_only=True)
class SegmentConfig:
    """One segment of a motion. Give either its duration or its peak speed.

    Attributes:
        kind: ``hold``; ``press`` to a depth; ``lift`` off; ``release`` suddenly; ``slide`` by (dx,
            dy); ``rub`` forwards and back; ``twist`` about the normal; ``circle``; ``roll``.
        duration_s: Duration, s.
        speed_mm_s: Peak speed of the reference point, mm/s.
        speed_deg_s: Peak rate of a twist, degrees/s.
        profile: Time law of each stroke.
        depth_mm: Depth at the end, mm (absolute; negative is above the skin).
        height_mm: Height above the skin after a lift or release, mm.
        dx_mm: Displacement to the right, mm.
        dy_mm: Displacement downwards in the image, mm.
        repeats: Number of forward-and-back strokes of a rub.
        angle_deg: Angle of a twist, degrees from x towards y.
        radius_mm: Radius of the circle, or of the rolling body, mm.
        turns: Number of turns of a circle; negative for the opposite sense.
        heading_deg: Direction from the start to the circle's centre, degrees.
    """

    kind: SegmentKind
    duration_s: float | None = None
    speed_mm_s: float | None = None
    speed_deg_s: float | None = None
    profile: Profile = "minimum_jerk"
    depth_mm: float | None = None
    height_mm: float | None = None
    dx_mm: float | None = None
    dy_mm: float | None = None
    repeats: int | None = None
    angle_deg: float | None = None
    radius_mm: float | None = None
    turns: float | None = None
    heading_deg: float | None = None

    def __post_init__(self) -> None:
        given = {field.name for field in fields(self) if getattr(self, field.name) is not None}
        needed, allowed = _FIELDS[self.kind]
        for name in sorted(given - {"kind", "duration_s", "profile", *needed, *allowed}):
            valid = (*needed, *allowed)
            raise ValueError(f"{name} has no meaning for {self.kind!r} (valid: {valid})")
        for name in needed:
            if name not in given:
                raise ValueError(f"{self.kind!r} needs {name}")
        timing = sorted(given & {*_TIMING})
        if len(timing) > 1 or (not timing and self.kind != "release"):
            raise ValueError(f"{self.kind!r} needs one of duration_s and a speed, got {timing}")
        require_within(self, **_LIMITS)


FRAME = "skin"  # Name of the frame of indenter poses.
NORMAL = np.array([0.0, 0.0, 1.0])  # Axis of yaw and twist.

CLEARANCE_MM = 1.0  # Default height above the skin at the start of a motion and after a lift, mm.

RELEASE_S = 0.005  # Duration of a sudden release, s (one frame of a fast camera).

# Fraction of a trapezoid's duration for the acceleration, and the same for the deceleration.
RAMP_FRACTION = 0.2


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """Start of an indenter above the skin, and the segments that follow.

    Attributes:
        x_mm: Start, to the right of the optical axis, mm.
        y_mm: Start, below the optical axis, mm.
        yaw_deg: Heading of the indenter about the normal, degrees from x towards y.
        height_mm: Height above the skin at the start, mm.
        segments: The segments in order.
    """

    x_mm: float = 0.0
    y_mm: float = 0.0
    yaw_deg: float = 0.0
    height_mm: float = CLEARANCE_MM
    segments: tuple[SegmentConfig, ...] = ()


class IndenterMotion:
    """The pose of an indenter as a function of time.

    Args:
        config: Start and segments.

    Attributes:
        starts_s: Start of every segment, then the end of the last, s.
        duration_s: Time from the first segment's start to the last one's end, s.

    Example:
        >>> press = SegmentConfig(kind="press", depth_mm=0.8, duration_s=0.5)
        >>> motion = IndenterMotion(MotionConfig(height_mm=0.2, segments=(press,)))
        >>> motion.pose(0.25).position_mm
        array([0. , 0. , 0.3])
    """

    def __init__(self, config: MotionConfig) -> None:
        self.starts_s = [0.0]
        position = np.array([config.x_mm, config.y_mm, -config.height_mm])
        pose = Pose(position, rotation_about(NORMAL, math.radians(config.yaw_deg)), FRAME)
        self._segments: list[tuple[SegmentConfig, Pose, float]] = []
        for segment in config.segments:
            duration = _duration_s(segment, pose)
            self._segments.append((segment, pose, duration))
            self.starts_s.append(self.starts_s[-1] + duration)
            pose = _pose(segment, pose, 1.0)
        self.duration_s, self._end = self.starts_s[-1], pose

    def pose(self, t_s: float) -> Pose:
        """Return the pose at ``t_s`` (s). It is constant before the start and after the end."""
        index = max(bisect.bisect_right(self.starts_s, t_s) - 1, 0)
        if index >= len(self._segments):
            return self._end
        segment, start, duration = self._segments[index]
        elapsed = max(t_s - self.starts_s[index], 0.0)
        return _pose(segment, start, elapsed / duration if duration > 0 else 1.0)


def minimum_jerk(fraction: float) -> float:
    """Return the completed fraction of a stroke at a fraction of its time (Flash & Hogan 1985)."""
    return fraction**3 * (10.0 + fraction * (6.0 * fraction - 15.0))


def trapezoid(fraction: float) -> float:
    """Return the completed fraction of a stroke with constant speed between two ramps."""
    mirrored = min(fraction, 1.0 - fraction)
    peak = 1.0 / (1.0 - RAMP_FRACTION)
    if mirrored < RAMP_FRACTION:
        covered = 0.5 * peak * mirrored**2 / RAMP_FRACTION
    else:
        covered = peak * (mirrored - 0.5 * RAMP_FRACTION)
    return covered if fraction <= 0.5 else 1.0 - covered


# Profile -> its law, and its peak speed over its mean: 30/16 at mid-stroke for minimum jerk.
_PROFILES: dict[str, tuple[Callable[[float], float], float]] = {
    "minimum_jerk": (minimum_jerk, 1.875),
    "trapezoid": (trapezoid, 1.0 / (1.0 - RAMP_FRACTION)),
}


def rotation_about(axis: FloatArray, angle_rad: float) -> FloatArray:
    """Return the ``(3, 3)`` rotation about a unit axis ``(3,)`` (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle_rad) * cross + (1.0 - math.cos(angle_rad)) * cross @ cross


def _duration_s(segment: SegmentConfig, start: Pose) -> float:
    """Return the duration of a segment, given or computed from its peak speed, s."""
    if segment.duration_s is not None:
        return segment.duration_s
    peak_over_mean = _PROFILES[segment.profile][1]
    if segment.speed_deg_s is not None:
        return abs(segment.angle_deg or 0.0) * peak_over_mean / segment.speed_deg_s
    if segment.speed_mm_s is None:
        return RELEASE_S
    path_mm = 2 * (segment.repeats or 0.5) * float(np.linalg.norm(_offset_mm(segment, start, 1.0)))
    if segment.kind == "circle":
        path_mm = 2.0 * math.pi * (segment.radius_mm or 0.0) * abs(segment.turns or 0.0)
    return path_mm * peak_over_mean / segment.speed_mm_s


def _pose(segment: SegmentConfig, start: Pose, fraction: float) -> Pose:
    """Return the pose at a fraction, 0 to 1, of a segment's time."""
    profile, strokes = _PROFILES[segment.profile][0], 2 * (segment.repeats or 0.5)
    along = min(max(fraction, 0.0), 1.0) * strokes
    stroke = min(int(along), math.ceil(strokes) - 1)
    covered = profile(along - stroke)
    if stroke % 2:
        covered = 1.0 - covered
    position = start.position_mm + _offset_mm(segment, start, covered)
    turn = _turn(segment, covered)
    return Pose(position, start.rotation if turn is None else turn @ start.rotation, FRAME)


def _offset_mm(segment: SegmentConfig, start: Pose, covered: float) -> FloatArray:
    offset = np.array([segment.dx_mm or 0.0, segment.dy_mm or 0.0, 0.0]) * covered
    if segment.kind in ("lift", "release"):
        height = CLEARANCE_MM if segment.height_mm is None else segment.height_mm
        offset[2] = (-height - start.position_mm[2]) * covered
    elif segment.depth_mm is not None:
        offset[2] = (segment.depth_mm - start.position_mm[2]) * covered
    elif segment.kind == "circle":
        radius, heading = segment.radius_mm or 0.0, math.radians(segment.heading_deg or 0.0)
        angle = heading + 2.0 * math.pi * (segment.turns or 0.0) * covered
        offset[0] = radius * (math.cos(heading) - math.cos(angle))
        offset[1] = radius * (math.sin(heading) - math.sin(angle))
    return offset


def _turn(segment: SegmentConfig, covered: float) -> FloatArray | None:
    if segment.angle_deg is not None:
        return rotation_about(NORMAL, math.radians(segment.angle_deg) * covered)
    distance = math.hypot(segment.dx_mm or 0.0, segment.dy_mm or 0.0)
    if segment.kind != "roll" or distance == 0.0:
        return None
    # The body's centre lies at z < 0: this turn moves its contact point backwards.
    axis = np.array([segment.dy_mm or 0.0, -(segment.dx_mm or 0.0), 0.0]) / distance
    return rotation_about(axis, distance * covered / (segment.radius_mm or 1.0))
