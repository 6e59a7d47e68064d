"""The rig: arm, grasped probe, gel pads and event cameras on one clock.

Asking for the next stretch of time moves everything: the arm goes on with its motion, the probe
meets the wall, the pads' markers follow, and the cameras report what they saw.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.robot.arm import ArmState
from spikingtac.sim.optics.states import MarkerImage, SkinState
from spikingtac.sim.rig.pad_modes import Pad, PadConfig
from spikingtac.sim.rig.pads import PatchConfig
from spikingtac.sim.rig.probe import Probe, ProbeConfig, ProbeState
from spikingtac.sim.rig.ur3 import UR3Config, UR3Twin
from spikingtac.sim.rig.vibration import Vibration, VibrationConfig
from spikingtac.sim.rig.walls import Wall
from spikingtac.types import EventPacket

Vector = NDArray[np.float64]

WAIT_S = 0.001
"""How often a waiting loop looks, s: one controller window."""


class Finger(Protocol):
    """One finger's optics and camera; see :class:`spikingtac.sim.rig.fingers.SensingFinger`."""

    def look(self, state: SkinState) -> MarkerImage:
        """Return the image of the markers."""
        ...

    def settle(self, image: MarkerImage) -> None:
        """Let every pixel come to rest under an image."""
        ...

    def advance(self, images: Sequence[MarkerImage]) -> EventPacket:
        """Return the events up to the last image, remembering every pixel's reference."""
        ...


@dataclass(frozen=True, kw_only=True)
class RigConfig:
    """What the rig is made of, and how finely it steps.

    Attributes:
        probe: The rod and its grip.
        patch: The patch of each pad that sticks to the rod.
        pad: How each pad sits on the rod.
        vibration: Of the arm.
        arm: Its dynamics.
        step_us: Longest step of the mechanics, us (twin.md: 250 to 500 Hz keeps real time).
        near_mm: Longest travel in one step within reach of the wall and in contact, mm.
        least_step_us: Shortest step, us.
        force_limit_n: Force at the tip at which the controller makes a protective stop, N; None
            for never (the forces of a bending probe stay far below what a UR3 notices).
    """

    probe: ProbeConfig = field(default_factory=ProbeConfig)
    patch: PatchConfig = field(default_factory=PatchConfig)
    pad: PadConfig = field(default_factory=PadConfig)
    vibration: VibrationConfig = field(default_factory=VibrationConfig)
    arm: UR3Config = field(default_factory=UR3Config)
    step_us: int = 1000
    near_mm: float = 0.04
    least_step_us: int = 100
    force_limit_n: float | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.least_step_us <= self.step_us or not self.near_mm > 0.0:
            raise ValueError("need 1 <= least_step_us <= step_us and a positive near_mm")


@dataclass(frozen=True, kw_only=True)
class HistoryTouch:
    """The contact before the experiment (contract.md: released 1 s earlier, never fresh).

    Attributes:
        press_mm: How far the arm goes beyond the first touch, mm (ours: a typical overshoot).
        speed_mm_s: Of approach and return, mm/s.
        hold_s: How long it presses, s.
        wait_s: From the release to the end, s.
    """

    press_mm: float = 1.0
    speed_mm_s: float = 20.0
    hold_s: float = 0.2
    wait_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Touch:
    """The first touch since the last :meth:`Rig.forget_touch`, exact within a step.

    Attributes:
        t_us: When, us (not rounded to a step).
        arm_mm: ``(3,)`` the arm's true position then, without its vibration, mm: X_real.
    """

    t_us: float
    arm_mm: Vector


class Rig:
    """Arm, probe, pads and cameras on one clock.

    Args:
        config: What it is made of.
        wall: What the tip can touch.
        fingers: One or two sensing fingers; the first is pad A, the second faces it.
        start_mm: Where the arm holds the tip at first, base frame, mm.
        rng: Source of everything random in arm and vibration.
    """

    def __init__(
        self,
        config: RigConfig,
        wall: Wall,
        fingers: Sequence[Finger],
        start_mm: Vector,
        rng: np.random.Generator,
    ) -> None:
        if not 1 <= len(fingers) <= 2:
            raise ValueError(f"a gripper has one or two sensing fingers, got {len(fingers)}")
        self.arm = UR3Twin(config.arm, start_mm, rng)
        self.vibration = Vibration(config.vibration, rng)
        self.touch: Touch | None = None
        self.t_us = 0
        self._config = config
        self._rotation = config.probe.rotation()
        self._fingers = tuple(fingers)
        shaken = self.arm.true_position_mm() + self.vibration.offset_mm
        self.probe = Probe(config.probe, wall, shaken)
        self._pads = [
            Pad(config.pad, config.patch, faces_back=bool(k)) for k in range(len(fingers))
        ]
        self.state = self.probe.at_rest(0)
        self._images = self._look()
        for finger, image in zip(self._fingers, self._images, strict=True):
            finger.settle(image)

    @property
    def markers_px(self) -> tuple[Vector, ...]:
        """True marker centres ``(m, 2)`` of each sensor now, px."""
        return tuple(image.center_px for image in self._images)

    def skin(self, sensor: int = 0) -> SkinState:
        """Return the skin of one finger now."""
        return self._pads[sensor].skin(self.state, self._rotation)

    def carry(self, to_mm: Vector) -> None:
        """Put the arm, at rest, elsewhere in free air; no time passes, and no pixel sees anything.

        It stands for travel through free air that leaves no trace but noise.

        Args:
            to_mm: ``(3,)`` where the arm then holds the tip, mm.

        Raises:
            ValueError: The tip is in contact.
            DeviceError: The arm moves.
        """
        if self.state.in_contact:
            raise ValueError("the tip is in contact; only free air can be skipped")
        shift = to_mm - self.arm.true_position_mm()
        self.arm.place(to_mm)
        self.state = self.probe.carried(self.state, shift)

    def forget_touch(self) -> None:
        """Wait for the next first touch."""
        self.touch = None

    def advance(self, dt_us: int) -> tuple[tuple[EventPacket, ...], ProbeState]:
        """Let ``dt_us`` pass; return one packet per sensor, and the true state at the end."""
        if dt_us < 1:
            raise ValueError(f"dt_us is {dt_us}, it must be at least 1")
        end_us = self.t_us + dt_us
        films: list[list[MarkerImage]] = []
        while self.t_us < end_us:
            self._step(min(self._stride_us(), end_us - self.t_us))
            self._images = self._look()
            films.append(self._images)
        pairs = zip(self._fingers, zip(*films, strict=True), strict=True)
        return tuple(finger.advance(film) for finger, film in pairs), self.state

    def windows(self, period_us: int = 1000, sensor: int = 0) -> Iterator[EventPacket]:
        """Yield the windows of one sensor, for ever; each pull advances the whole rig."""
        for packets in self.paired_windows(period_us):
            yield packets[sensor]

    def paired_windows(self, period_us: int = 1000) -> Iterator[tuple[EventPacket, ...]]:
        """Yield the windows of every sensor together, for ever."""
        while True:
            yield self.advance(period_us)[0]

    def rest(self, duration_s: float) -> None:
        """Let time pass and drop the events."""
        end_us = self.t_us + round(duration_s * 1e6)
        while self.t_us < end_us:
            self.advance(min(self._config.step_us, end_us - self.t_us))

    def press_and_release(self, reach_mm: Vector, config: HistoryTouch) -> None:
        """Touch the wall, come back and wait: the contact whose traces the pixels inherit.

        The arm starts at rest, moves by ``reach_mm`` plus the press along it, holds, returns to
        where it was and waits. The events are dropped and the touch is forgotten.

        Args:
            reach_mm: ``(3,)`` way to the wall, mm.
            config: How far to press, how long to hold and to wait.
        """
        home_mm = self.arm.true_position_mm()
        way = reach_mm * (1.0 + config.press_mm / float(np.linalg.norm(reach_mm)))
        self._travel(home_mm + way, config.speed_mm_s)
        self.rest(config.hold_s)
        self.arm.move_linear(home_mm, config.speed_mm_s)
        while self.state.in_contact:
            self.rest(WAIT_S)
        released_us = self.t_us
        while self.arm.state() is ArmState.MOVING:
            self.rest(WAIT_S)
        self.rest(max(config.wait_s - (self.t_us - released_us) * 1e-6, 0.0))
        self.touch = None

    def _travel(self, target_mm: Vector, speed_mm_s: float) -> None:
        self.arm.move_linear(target_mm, speed_mm_s)
        while self.arm.state() is ArmState.MOVING:
            self.rest(WAIT_S)

    def _look(self) -> list[MarkerImage]:
        return [finger.look(self.skin(k)) for k, finger in enumerate(self._fingers)]

    def _stride_us(self) -> int:
        """Return the length of the next step: short where the tip is at the wall and moves.

        Steps end on multiples of the longest one, so that pulling in any number of those gives the
        same states.
        """
        config = self._config
        left_us = config.step_us - self.t_us % config.step_us
        ahead = self.arm.position_at_mm(self.t_us + config.step_us)
        travel = math.dist(ahead, self.arm.true_position_mm())
        if travel <= config.near_mm or self.state.gap_mm > 2.0 * travel:
            return left_us
        most = config.step_us // config.least_step_us
        pieces = min(math.ceil(travel / config.near_mm), most)
        return min(math.ceil(config.step_us / pieces), left_us)

    def _step(self, dt_us: int) -> None:
        t_us, before = self.t_us + dt_us, self.state
        held_before = self.arm.true_position_mm()
        self.arm.advance_to(t_us)
        held = self.arm.true_position_mm()
        dt_s = dt_us * 1e-6
        self.state = self.probe.step(t_us, dt_s, held + self.vibration.advance(dt_s))
        self.t_us = t_us
        limit_n = self._config.force_limit_n
        if limit_n is not None and float(np.linalg.norm(self.state.force_n)) > limit_n:
            self.arm.protective_stop()
        if self.touch is None and self.state.in_contact:
            share = _crossing(before.gap_mm, self.state.free_gap_mm)
            where = held_before + share * (held - held_before)
            self.touch = Touch(t_us - dt_us * (1.0 - share), where)


def _crossing(gap_before: float, gap_after: float) -> float:
    """Return at which share of a step the gap became zero."""
    if gap_before <= 0.0 or gap_after >= 0.0:
        return 0.0
    return gap_before / (gap_before - gap_after)
