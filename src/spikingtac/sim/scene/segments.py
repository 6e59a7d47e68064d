"""The segments of a motion: their kinds, and the settings of each kind."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

SegmentKind = Literal["hold", "press", "lift", "release", "slide", "rub", "twist", "circle", "roll"]
Profile = Literal["minimum_jerk", "trapezoid"]

_NEEDED: dict[str, tuple[str, ...]] = {
    "hold": (),
    "press": ("depth_mm",),
    "lift": (),
    "release": (),
    "slide": (),
    "rub": ("repeats",),
    "twist": ("angle_deg",),
    "circle": ("radius_mm", "turns"),
    "roll": ("radius_mm",),
}
_ALLOWED: dict[str, tuple[str, ...]] = {
    "hold": (),
    "press": (),
    "lift": ("height_mm",),
    "release": ("height_mm",),
    "slide": ("dx_mm", "dy_mm", "depth_mm"),
    "rub": ("dx_mm", "dy_mm"),
    "twist": ("depth_mm",),
    "circle": ("heading_deg",),
    "roll": ("dx_mm", "dy_mm"),
}
_ALWAYS = ("kind", "duration_s", "speed_mm_s", "speed_deg_s", "profile")


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
        valid = (*_NEEDED[self.kind], *_ALLOWED[self.kind])
        for name in sorted(given):
            if name not in valid and name not in _ALWAYS:
                raise ValueError(f"{name} has no meaning for {self.kind!r} (valid: {valid})")
        for name in _NEEDED[self.kind]:
            if name not in given:
                raise ValueError(f"{self.kind!r} needs {name}")
        _check_timing(self, given)


def _check_timing(segment: SegmentConfig, given: set[str]) -> None:
    timing = sorted(given & {"duration_s", "speed_mm_s", "speed_deg_s"})
    if len(timing) > 1 or (not timing and segment.kind != "release"):
        raise ValueError(f"{segment.kind!r} needs one of duration_s and a speed, got {timing}")
    unfit = "speed_mm_s" if segment.kind in ("hold", "twist") else "speed_deg_s"
    if unfit in given and not (unfit == "speed_deg_s" and segment.kind == "twist"):
        raise ValueError(f"{unfit} has no meaning for {segment.kind!r}")
    for name in (*timing, "radius_mm", "repeats"):
        value = getattr(segment, name)
        if value is not None and not value > 0:
            raise ValueError(f"{name} is {value}, it must be positive")
