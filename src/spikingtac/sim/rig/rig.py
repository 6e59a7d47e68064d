"""The rig: arm, grasped probe, gel pads and event cameras on one clock.

Each call that advances the rig moves all parts: the arm continues its motion, the probe meets the
wall, the markers of the pads follow, and the cameras return their events.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac.sim.event_camera import EventCamera, ReferenceHistory
from spikingtac.sim.optics import MarkerImage, Optics, OpticsConfig, SkinState
from spikingtac.sim.rig.pad import Pad
from spikingtac.sim.rig.probe import Probe, ProbeConfig, ProbeState, Vibration
from spikingtac.sim.rig.ur3 import UR3Config, UR3Twin
from spikingtac.sim.rig.walls import Wall
from spikingtac.sim.scene import CameraChoice
from spikingtac.types import EventPacket

# Longest and shortest step of the mechanics, us (twin.md: 250 to 500 Hz keeps real time).
STEP_US, SHORTEST_STEP_US = 1000, 100
NEAR_MM = 0.04  # Longest travel in one step near the wall and in contact, mm.
WAIT_S = 0.001  # Period at which a waiting loop checks its condition, s: one controller window.

# Vibration of the arm for each preset, mm rms (contract.md, "Pinned physics").
VIBRATION_MM = {"clean": 0.0, "typical": 0.01, "noisy": 0.03}

# Motion of a marker before it is rendered again, px: 1.5 % of a threshold at the marker's edge, and
# two windows at 0.8 mm/s. It saves a third of the computing time under vibration.
STEP_SETTINGS = {"steps": {"still_px": 0.005}}

# Edge of a disc as in the v2e recordings: theirs is logistic with scale 0.55 px, which equals a
# Gaussian of 0.94 px with the square pixel included. The tip's travel up to the first events is
# proportional to it.
EDGE_SETTINGS = {"light": {"blur_px": 0.9}}


@dataclass(frozen=True, kw_only=True)
class FingerConfig:
    """One sensing finger.

    Attributes:
        camera: Preset ``clean``, ``typical`` or ``noisy``.
        settings: Tables that override parts of the preset.
        optics: Lens and discs.
        history: Initial reference levels of the pixels; see
            :meth:`~spikingtac.sim.event_camera.EventCamera.settle`.
        serial: Number of the individual sensor. It fixes the discs, the mismatch of the pixels and
            the hot pixels.
    """

    camera: str = "typical"
    settings: dict[str, Any] = field(default_factory=lambda: EDGE_SETTINGS | STEP_SETTINGS)
    optics: OpticsConfig = field(default_factory=OpticsConfig)
    history: ReferenceHistory = "rested"
    serial: int = 1


class SensingFinger:
    """Optics and event camera of one finger.

    Args:
        config: Settings of the finger.
        seed: Seed of its noise.

    Attributes:
        optics: The lens.
        camera: The event camera.
    """

    def __init__(self, config: FingerConfig, seed: int) -> None:
        choice = CameraChoice(preset=config.camera, settings=config.settings)
        self.optics = Optics(config.optics, config.serial)
        camera = choice.resolve(config.optics.size)
        self.camera = EventCamera(camera, seed, serial=config.serial)
        self._history: ReferenceHistory = config.history

    def project(self, state: SkinState) -> MarkerImage:
        """Return the image of the markers."""
        return self.optics.project(state)

    def settle(self, image: MarkerImage) -> None:
        """Set every pixel to its steady state under an image, with the configured history."""
        self.camera.settle(image, self._history)

    def advance(self, images: Sequence[MarkerImage]) -> EventPacket:
        """Return the events up to the last image."""
        return self.camera.advance(images)


@dataclass(frozen=True, kw_only=True)
class RigConfig:
    """Parts of the rig.

    Attributes:
        probe: The rod and its bushing.
        vibration_mm: Root mean square of the arm's vibration per axis, mm.
        arm: Dynamics of the arm.
    """

    probe: ProbeConfig = field(default_factory=ProbeConfig)
    vibration_mm: float = VIBRATION_MM["typical"]
    arm: UR3Config = field(default_factory=UR3Config)


@dataclass(frozen=True, kw_only=True)
class PriorContact:
    """The contact before the experiment (contract.md: released 1 s earlier).

    Attributes:
        press_mm: Travel of the arm beyond the first touch, mm (a typical overshoot).
        speed_mm_s: Speed of approach and return, mm/s.
        hold_s: Time for which the probe presses, s.
        wait_s: Time from the release to the end, s.
    """

    press_mm: float = 1.0
    speed_mm_s: float = 20.0
    hold_s: float = 0.2
    wait_s: float = 1.0


@dataclass(frozen=True, slots=True)
class FirstContact:
    """The first contact since the last :meth:`Rig.reset_first_contact`, interpolated within a step.

    Attributes:
        t_us: Time, us (not rounded to a step).
        arm_mm: ``(3,)`` true position of the arm then, without its vibration, mm: X_real.
    """

    t_us: float
    arm_mm: FloatArray


class Rig:
    """Arm, probe, pads and cameras on one clock.

    Args:
        config: Parts of the rig.
        wall: The wall that the tip can touch.
        fingers: One or two sensing fingers. The first is pad A; the second faces it.
        start_mm: ``(3,)`` initial position at which the arm holds the tip, base frame, mm.
        rng: Source of all random numbers of arm and vibration.

    Attributes:
        arm: The arm.
        vibration: Vibration of the arm.
        probe: The probe.
        state: True state of the probe.
        first_contact: First contact, or None.
        t_us: Present time, us.

    Raises:
        ValueError: There are not one or two fingers.
    """

    def __init__(
        self,
        config: RigConfig,
        wall: Wall,
        fingers: Sequence[SensingFinger],
        start_mm: FloatArray,
        rng: np.random.Generator,
    ) -> None:
        if not 1 <= len(fingers) <= 2:
            raise ValueError(f"a gripper has one or two sensing fingers, got {len(fingers)}")
        self.arm = UR3Twin(config.arm, start_mm, rng)
        self.vibration = Vibration(config.vibration_mm, rng)
        self.first_contact: FirstContact | None = None
        self.t_us = 0
        self._fingers = tuple(fingers)
        shaken = self.arm.true_position_mm() + self.vibration.offset_mm
        self.probe = Probe(config.probe, wall, shaken)
        self._pads = [Pad(faces_back=bool(k)) for k in range(len(fingers))]
        self.state = self.probe.at_rest(0)
        self._images = self._project_markers()
        for finger, image in zip(self._fingers, self._images, strict=True):
            finger.settle(image)

    @property
    def markers_px(self) -> tuple[FloatArray, ...]:
        """True marker centres ``(m, 2)`` of each sensor now, px."""
        return tuple(image.center_px for image in self._images)

    def skin(self, sensor: int = 0) -> SkinState:
        """Return the skin of one finger now."""
        return self._pads[sensor].skin(self.state)

    def relocate(self, to_mm: FloatArray) -> None:
        """Move the arm, at rest, to another place at once. No time passes and no pixel changes.

        This replaces travel through free air that leaves no trace but noise.

        Args:
            to_mm: ``(3,)`` new position at which the arm holds the tip, mm.

        Raises:
            ValueError: The tip is in contact.
            DeviceError: The arm moves.
        """
        if self.state.in_contact:
            raise ValueError("the tip is in contact; only free air can be skipped")
        shift = to_mm - self.arm.true_position_mm()
        self.arm.relocate(to_mm)
        self.state = self.probe.relocated(self.state, shift)

    def reset_first_contact(self) -> None:
        """Forget the first contact and wait for the next one."""
        self.first_contact = None

    def advance(self, dt_us: int) -> tuple[tuple[EventPacket, ...], ProbeState]:
        """Advance by ``dt_us``.

        Returns:
            One packet for each sensor, and the true state at the end.

        Raises:
            ValueError: ``dt_us`` is below 1.
        """
        if dt_us < 1:
            raise ValueError(f"dt_us is {dt_us}, it must be at least 1")
        end_us = self.t_us + dt_us
        images: list[list[MarkerImage]] = []
        while self.t_us < end_us:
            self._step(min(self._step_length_us(), end_us - self.t_us))
            self._images = self._project_markers()
            images.append(self._images)
        pairs = zip(self._fingers, zip(*images, strict=True), strict=True)
        return tuple(finger.advance(image_sequence) for finger, image_sequence in pairs), self.state

    def windows(self, period_us: int = 1000, sensor: int = 0) -> Iterator[EventPacket]:
        """Yield the windows of one sensor without end. Each window advances the whole rig."""
        for packets in self.paired_windows(period_us):
            yield packets[sensor]

    def paired_windows(self, period_us: int = 1000) -> Iterator[tuple[EventPacket, ...]]:
        """Yield the windows of all sensors together without end."""
        while True:
            yield self.advance(period_us)[0]

    def wait(self, duration_s: float) -> None:
        """Advance by ``duration_s`` and drop the events."""
        end_us = self.t_us + round(duration_s * 1e6)
        while self.t_us < end_us:
            self.advance(min(STEP_US, end_us - self.t_us))

    def _project_markers(self) -> list[MarkerImage]:
        return [finger.project(self.skin(k)) for k, finger in enumerate(self._fingers)]

    def _step_length_us(self) -> int:
        """Return the length of the next step, us. It is short where the tip moves near the wall.

        Steps end on multiples of the longest one, so that packets of any number of those give the
        same states.
        """
        left_us = STEP_US - self.t_us % STEP_US
        next_mm = self.arm.position_at_mm(self.t_us + STEP_US)
        travel = math.dist(next_mm, self.arm.true_position_mm())
        if travel <= NEAR_MM or self.state.gap_mm > 2.0 * travel:
            return left_us
        max_pieces = STEP_US // SHORTEST_STEP_US
        pieces = min(math.ceil(travel / NEAR_MM), max_pieces)
        return min(math.ceil(STEP_US / pieces), left_us)

    def _step(self, dt_us: int) -> None:
        t_us, before = self.t_us + dt_us, self.state
        arm_before = self.arm.true_position_mm()
        self.arm.advance_to(t_us)
        arm_now = self.arm.true_position_mm()
        dt_s = dt_us * 1e-6
        self.state = self.probe.step(t_us, dt_s, arm_now + self.vibration.advance(dt_s))
        self.t_us = t_us
        if self.first_contact is None and self.state.in_contact:
            gap, free_gap = before.gap_mm, self.state.free_gap_mm
            # The fraction of the step at which the gap became zero.
            fraction = gap / (gap - free_gap) if gap > 0.0 > free_gap else 0.0
            where = arm_before + fraction * (arm_now - arm_before)
            self.first_contact = FirstContact(t_us - dt_us * (1.0 - fraction), where)
