"""Drawn contacts that stick, slip in part and slip, and scenes of the twin as a sensor feels them.

The latter are tracked by ``default`` from their events.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spikingtac import Calibration, follow, make_tracker
from spikingtac.config import load_config
from spikingtac.sim import (
    ContactConfig,
    GelConfig,
    IndenterConfig,
    MotionConfig,
    Scene,
    SceneSource,
    SegmentConfig,
)
from spikingtac.types import EventPacket, MarkerFrame


@dataclass(frozen=True, slots=True)
class Body:
    """A body and the ranges of its sizes and depth.

    Attributes:
        name: What it is.
        kind: Name of the indenter.
        sizes_mm: Range of each of its drawn sizes, mm, by the settings that it is given to.
        depth_mm: Range of the depth, mm.
        turned: Whether its heading is drawn, too.
    """

    name: str
    kind: str
    sizes_mm: Mapping[tuple[str, ...], tuple[float, float]]
    depth_mm: tuple[float, float]
    turned: bool = False

    def indenter(self, rng: np.random.Generator) -> IndenterConfig:
        """Return the body with drawn sizes."""
        settings: dict[str, float] = {}
        for names, span_mm in self.sizes_mm.items():
            settings |= dict.fromkeys(names, float(rng.uniform(*span_mm)))
        return IndenterConfig(kind=self.kind, settings=settings)

    def yaw_deg(self, rng: np.random.Generator) -> float:
        """Return a drawn heading, degrees; 0 for a body that is alike from all sides."""
        return float(rng.uniform(0.0, 180.0)) if self.turned else 0.0


BOTH_RADII = ("radius_x_mm", "radius_y_mm")  # Settings of a body that is round about its axis.

# Bodies that are alike from all sides.
ROUND = (
    Body("ball", "ball", {BOTH_RADII: (3.0, 8.0)}, (0.4, 0.9)),
    Body("punch", "punch", {("radius_mm",): (2.0, 4.5)}, (0.2, 0.45)),
    Body("finger", "finger", {BOTH_RADII: (6.0, 8.0)}, (1.2, 2.2)),
)
_CAP_MM = {
    ("radius_x_mm",): (5.0, 20.0),
    ("radius_y_mm",): (5.0, 20.0),
    ("half_height_mm",): (5.0, 12.0),
}
_ROD_MM = {("radius_mm",): (2.0, 6.0), ("length_mm",): (2.0, 8.0)}

# Bodies that are longer in one direction.
LONG = (
    Body("ellipsoid", "ball", _CAP_MM, (0.4, 0.8), turned=True),
    Body("rod", "probe", _ROD_MM, (0.3, 0.8), turned=True),
)
TAUGHT = (*ROUND, *LONG)  # Bodies that the slip model is fitted to.

# Bodies that it is tested on: the spoon was never seen.
TESTED = (*ROUND, Body("spoon", "spoon", {}, (0.4, 0.8)))

FRICTIONS = (0.25, 0.95)  # Range of the coefficients of friction, unless some are given.
SPEEDS_MM_S = (2.0, 80.0)  # Range of the drags' speeds, mm/s; their logarithms are uniform.
FAST_MM_S = 20.0  # Speed above which the gel is stepped every 2 ms instead of 4.
SLIDE_MM = (2.5, 4.5)  # Range of the slides' lengths, mm; longer than any contact sticks.
SHORT_MM = (0.2, 1.2)  # Range of the drags that are to stick, mm per unit of friction.
TURN_DEG = (15.0, 60.0)  # Range of the twists' angles, degrees.

# Ranges of the twists' speeds at their rim, mm/s.
TWIST_MM_S, SLOW_TWIST_MM_S = (1.0, 8.0), (1.0, 3.0)
TWIST_ARM_MM = 3.0  # Radius of that rim, mm.
LEAST_SPEED_MM_S = 4.0  # Slowest motion there and back, mm/s: slower ones take too long.
PLACE_MM = 2.5  # Contacts begin within this distance of the middle, per axis, mm.
LIFT_S = 0.2  # Duration of the release, s.

# How every contact ends.
RELEASE = (
    SegmentConfig(kind="hold", duration_s=0.2),
    SegmentConfig(kind="lift", height_mm=0.3, duration_s=LIFT_S),
)
SLOW_MM_S = (1.5, 6.0)  # Range of the speeds of motions that are slow by their kind, mm/s.
ROLL_MM, ROLLS_MM = 7.0, (3.0, 15.0)  # Radius of a rolling body, and range where it is drawn, mm.

# What is drawn from: slides count twice.
KINDS = ("slide", "slide", "stick", "twist", "rub", "short-rub", "circle", "roll", "deepen",
         "twice")  # fmt: skip

# What half of the slip model is fitted to: more slow motions, and rolls of any radius.
VARIED_KINDS = (*KINDS, "slow-slide", "slow-twist", "slow-circle", "any-roll")

# A body that is held and disturbed, as when it is carried; drawn only where it is asked for.
CARRY = "carry"
HOLD = "hold"  # A body that is pressed and held still for long; drawn only where it is asked for.
HOLD_S = 20.0  # Duration of that, s.

# Kinds in which a body stays about where it was pressed.
IN_PLACE = ("twist", "circle", "slow-twist", "slow-circle", CARRY, HOLD)
CARRY_MOVES = 10  # Disturbances of one carried body, a second each.

# Largest distance of a carried body from where it was taken, mm per unit of friction.
CARRY_MM = 0.3
CARRY_DEPTH = (0.9, 1.15)  # Range of its depths, as a share of the first.
CARRY_REST_S = (0.1, 1.0)  # Range of the rests between its moves, s.


@dataclass(frozen=True, slots=True)
class DrawnContact:
    """One drawn contact.

    Attributes:
        kind: What the body does, of :data:`KINDS`.
        body: Its name.
        friction: Coefficient of friction.
        speed_mm_s: Peak speed of the drag, mm/s (of a twist: at its rim).
        scene: The scene.
    """

    kind: str
    body: str
    friction: float
    speed_mm_s: float
    scene: Scene

    @property
    def mechanics_hz(self) -> float:
        """Rate of the gel's steps that this motion needs, Hz."""
        return 500.0 if self.speed_mm_s > FAST_MM_S or self.kind.endswith("twist") else 250.0


def draw_contact(
    rng: np.random.Generator,
    bodies: Sequence[Body] = TAUGHT,
    frictions: Sequence[float] = (),
    kinds: Sequence[str] = KINDS,
    gels: Sequence[GelConfig] = (GelConfig(),),
) -> DrawnContact:
    """Return a random contact.

    Args:
        rng: Where it is drawn from.
        bodies: Bodies to choose from.
        frictions: Coefficients to choose from; uniform in :data:`FRICTIONS` unless given.
        kinds: Motions to choose from.
        gels: Gels to choose from; the contract's unless given. Friction is the contact's own.
    """
    gel = gels[int(rng.integers(len(gels)))] if len(gels) > 1 else gels[0]
    body = bodies[int(rng.integers(len(bodies)))]
    friction = float(rng.choice(frictions)) if frictions else float(rng.uniform(*FRICTIONS))
    kind = str(rng.choice(kinds))
    speed = float(np.exp(rng.uniform(*np.log(SPEEDS_MM_S))))
    depth = float(rng.uniform(*body.depth_mm))
    motion = _Motion(rng, friction, speed, depth)
    press = SegmentConfig(kind="press", depth_mm=depth, duration_s=float(rng.uniform(0.15, 0.5)))
    wait = SegmentConfig(kind="hold", duration_s=float(rng.uniform(0.05, 0.4)))
    segments = (press, wait, *_segments(kind, motion), *RELEASE)
    x, y = rng.uniform(-PLACE_MM, PLACE_MM, 2) - 0.5 * motion.way * (kind not in IN_PLACE)
    indenter, yaw = body.indenter(rng), body.yaw_deg(rng)
    course = MotionConfig(
        x_mm=float(x), y_mm=float(y), yaw_deg=yaw, height_mm=0.2, segments=segments
    )
    scene = Scene(
        about=f"{kind} of a {body.name}",
        lead_in_s=0.15,
        lead_out_s=0.1,
        gel=replace(gel, friction=friction),
        contacts=(ContactConfig(indenter=indenter, motion=course),),
    )
    return DrawnContact(kind, body.name, friction, motion.speed, scene)


class _Motion:
    """What is drawn for one motion; a kind may change its speed and its way."""

    def __init__(
        self, rng: np.random.Generator, friction: float, speed: float, depth_mm: float
    ) -> None:
        self.rng, self.friction, self.speed, self.depth_mm = rng, friction, speed, depth_mm
        heading = rng.uniform(0.0, 2.0 * np.pi)
        self.along = np.array([np.cos(heading), np.sin(heading)])
        self.heading_deg = float(np.degrees(heading))
        self.profile = str(rng.choice(["trapezoid", "minimum_jerk"]))
        self.way = rng.uniform(*SLIDE_MM) * self.along

    def segment(self, kind: str, share: float = 1.0, **settings: float | int) -> SegmentConfig:
        """Return a segment along the way."""
        dx, dy = (share * self.way).tolist()
        return SegmentConfig(
            kind=kind,  # type: ignore[arg-type]
            dx_mm=dx,
            dy_mm=dy,
            speed_mm_s=self.speed,
            profile=self.profile,  # type: ignore[arg-type]
            **settings,  # type: ignore[arg-type]
        )


def _twist(motion: _Motion, speeds_mm_s: tuple[float, float]) -> list[SegmentConfig]:
    angle = float(motion.rng.choice([-1.0, 1.0]) * motion.rng.uniform(*TURN_DEG))
    motion.speed = float(motion.rng.uniform(*speeds_mm_s))
    rate_deg_s = float(np.degrees(motion.speed / TWIST_ARM_MM))
    return [SegmentConfig(kind="twist", angle_deg=angle, speed_deg_s=rate_deg_s)]


def _circle(motion: _Motion) -> list[SegmentConfig]:
    return [
        SegmentConfig(
            kind="circle", radius_mm=float(motion.rng.uniform(0.3, 1.0)), turns=1.0,
            heading_deg=motion.heading_deg, speed_mm_s=motion.speed,
        )
    ]  # fmt: skip


def _carry(motion: _Motion) -> list[SegmentConfig]:
    """Return small moves about the first place, each with its own depth, and rests."""
    segments, here = [], np.zeros(2)
    for _ in range(CARRY_MOVES):
        angle, far = motion.rng.uniform(0.0, 2.0 * np.pi), np.sqrt(motion.rng.uniform())
        there = CARRY_MM * motion.friction * far * np.array([np.cos(angle), np.sin(angle)])
        motion.way, here = there - here, there
        depth = motion.depth_mm * float(motion.rng.uniform(*CARRY_DEPTH))
        motion.speed = float(np.exp(motion.rng.uniform(*np.log(SPEEDS_MM_S))))
        rest = SegmentConfig(kind="hold", duration_s=float(motion.rng.uniform(*CARRY_REST_S)))
        segments += [motion.segment("slide", depth_mm=depth), rest]
    return segments


_PAUSE = SegmentConfig(kind="hold", duration_s=0.3)

# Motion -> its segments.
_DRAWN: dict[str, Callable[[_Motion], list[SegmentConfig]]] = {
    "slide": lambda m: [m.segment("slide")],
    "rub": lambda m: [m.segment("rub", 0.6, repeats=2)],
    "circle": _circle,
    "roll": lambda m: [m.segment("roll", 0.7, radius_mm=ROLL_MM)],
    "any-roll": lambda m: [m.segment("roll", 0.7, radius_mm=float(m.rng.uniform(*ROLLS_MM)))],
    "twist": lambda m: _twist(m, TWIST_MM_S),
    "slow-twist": lambda m: _twist(m, SLOW_TWIST_MM_S),
    "deepen": lambda m: [m.segment("slide", depth_mm=m.depth_mm * float(m.rng.uniform(0.6, 1.3)))],
    "twice": lambda m: [m.segment("slide", 0.5), _PAUSE, m.segment("slide", 0.5)],
    CARRY: _carry,
    HOLD: lambda m: [SegmentConfig(kind="hold", duration_s=HOLD_S)],
}

# Kinds that are another motion: on a way on which most contacts stick, or slow.
_CHANGED = {
    "stick": "slide", "short-rub": "rub", "slow-slide": "slide", "slow-circle": "circle"
}  # fmt: skip


def _segments(kind: str, motion: _Motion) -> list[SegmentConfig]:
    """Return the motion of a kind, which may change speed and way."""
    if kind in ("stick", "short-rub"):
        motion.way = motion.rng.uniform(*SHORT_MM) * motion.friction * motion.along
    if kind in ("slow-slide", "slow-circle"):
        motion.speed = float(motion.rng.uniform(*SLOW_MM_S))
    kind = _CHANGED.get(kind, kind)
    if kind in ("rub", "circle", "roll", "any-roll"):
        motion.speed = max(motion.speed, LEAST_SPEED_MM_S)
    return _DRAWN[kind](motion)


RATE_HZ = 1_000.0  # Estimates per second.


def watch(
    source: SceneSource, note: Callable[[Any], None], rate_hz: float = RATE_HZ
) -> Iterator[MarkerFrame]:
    """Yield the markers that the tracker finds, with a calibration without error.

    Args:
        source: A fresh source of the scene.
        note: Is called with each :class:`~spikingtac.sim.SceneStep` before it is tracked.
        rate_hz: Estimates per second.
    """

    def packets() -> Iterator[EventPacket]:
        for step in source.steps():
            note(step)
            yield step.packet

    calibration = Calibration(
        reference_px=source.reference_px,
        radius_px=source.radius_px,
        grid=source.scene.skin.grid,
        size=source.size,
        polarity="white",
    )
    return follow(packets(), make_tracker(load_config("default").tracking, calibration), rate_hz)


def record(
    method: str, cases: Sequence[str], seed: int, scores: dict[str, float], source: str = "twin"
) -> dict[str, Any]:
    """Return scores as :func:`~spikingtac_paper.harness.report.rows_of` reads them.

    Args:
        method: Name of the method.
        cases: The case, then those that it is a part of.
        seed: Seed of the scene.
        scores: Metric -> value.
        source: ``twin`` or ``recorded``.
    """
    trial = {"case": cases[0], "groups": list(cases[1:]), "seed": seed, "source": source}
    return {"method": method, "trial": trial, "scores": scores}
