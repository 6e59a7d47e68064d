"""The rig: arm, grasped probe, gel pad and event camera on one clock.

Each call that advances the rig moves all parts: the arm continues its motion, the probe meets the
wall, the markers of the pad follow, and the camera returns its events.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from spikingtac.sim.camera.config import CameraConfig
from spikingtac.sim.camera.event_camera import EventCamera
from spikingtac.sim.optics import MarkerImage, Optics, OpticsConfig
from spikingtac.sim.rig.pad import Pad
from spikingtac.sim.rig.probe import Grasp, Probe, Vibration
from spikingtac.sim.rig.ur3 import UR3Twin
from spikingtac.sim.rig.walls import Wall
from spikingtac.sim.scene import CameraChoice
from spikingtac.types import EventPacket, FloatArray

# Longest and shortest step of the mechanics, us (twin.md: 250 to 500 Hz keeps real time).
STEP_US, SHORTEST_STEP_US = 1000, 100
NEAR_MM = 0.04  # Longest travel in one step near the wall and in contact, mm.

# Vibration of the arm for each preset, mm rms (contract.md, "Pinned physics").
VIBRATION_MM = {"clean": 0.0, "typical": 0.01, "noisy": 0.03}

# Motion of a marker before it is rendered again, px: 1.5 % of a threshold at the marker's edge, and
# two windows at 0.8 mm/s. It saves a third of the computing time under vibration.
STILL_PX = 0.005

# Edge of a disc as in the v2e recordings: theirs is logistic with scale 0.55 px, which equals a
# Gaussian of 0.94 px with the square pixel included. The tip's travel up to the first events is
# proportional to it.
EDGE_SETTINGS = {"light": {"blur_px": 0.9}}


def grip_camera(preset: str) -> CameraConfig:
    """Return a camera preset with the edge of the discs in the grip."""
    return CameraChoice(preset=preset, settings=EDGE_SETTINGS).resolve()


class SensingFinger:
    """Optics and event camera of one finger.

    Args:
        preset: Camera preset ``clean``, ``typical`` or ``noisy``.
        seed: Seed of its noise.
        optics: Lens and discs; the twin's unless given.
        serial: Number of the individual sensor. It fixes the discs, the mismatch of the pixels and
            the hot pixels.

    Attributes:
        optics: The lens.
        camera: The event camera.
    """

    def __init__(
        self, preset: str, seed: int, *, optics: OpticsConfig | None = None, serial: int = 1
    ) -> None:
        lens = optics or OpticsConfig()
        self.optics = Optics(lens, serial)
        self.camera = EventCamera(grip_camera(preset), lens.size, seed, serial, STILL_PX)


class FirstContact(NamedTuple):
    """The first contact since :attr:`Rig.first_contact` was None, interpolated within a step.

    Attributes:
        t_us: Time, us (not rounded to a step).
        arm_mm: ``(3,)`` true position of the arm then, without its vibration, mm: X_real.
    """

    t_us: float
    arm_mm: FloatArray


class Rig:
    """Arm, probe, pad and camera on one clock.

    The second pad holds the probe as the first does, but it has no camera.

    Args:
        arm: The arm, where it holds the tip at first.
        wall: The wall that the tip can touch.
        finger: The sensing finger.
        rng: Source of the vibration.
        grasp: The rod and its bushing; the usual ones unless given.
        vibration_mm: Root mean square of the arm's vibration per axis, mm.

    Attributes:
        arm: The arm.
        probe: The probe.
        state: True state of the probe.
        image: True image of the markers now.
        first_contact: First contact, or None; set it to None to wait for the next one.
        t_us: Present time, us.
    """

    def __init__(
        self,
        arm: UR3Twin,
        wall: Wall,
        finger: SensingFinger,
        rng: np.random.Generator,
        *,
        grasp: Grasp | None = None,
        vibration_mm: float = VIBRATION_MM["typical"],
    ) -> None:
        self.arm = arm
        self._vibration = Vibration(vibration_mm, rng)
        self.first_contact: FirstContact | None = None
        self.t_us = 0
        self._finger, self._pad = finger, Pad()
        held_mm = arm.true_position_mm() + self._vibration.offset_mm
        self.probe = Probe(grasp or Grasp(), wall, held_mm)
        self.state = self.probe.at_rest(0)
        self.image = finger.optics.project(self._pad.skin(self.state))
        finger.camera.settle(self.image)

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

    def advance(self, dt_us: int) -> EventPacket:
        """Advance by ``dt_us`` and return the events.

        Raises:
            ValueError: ``dt_us`` is below 1.
        """
        if dt_us < 1:
            raise ValueError(f"dt_us is {dt_us}, it must be at least 1")
        end_us = self.t_us + dt_us
        images: list[MarkerImage] = []
        while self.t_us < end_us:
            self._step(min(self._step_length_us(), end_us - self.t_us))
            self.image = self._finger.optics.project(self._pad.skin(self.state))
            images.append(self.image)
        return self._finger.camera.advance(images)

    def windows(self) -> Iterator[tuple[EventPacket]]:
        """Yield windows of 1 ms without end; each advances the whole rig."""
        while True:
            yield (self.advance(STEP_US),)

    def wait(self, duration_s: float) -> None:
        """Advance by ``duration_s`` and drop the events."""
        end_us = self.t_us + round(duration_s * 1e6)
        while self.t_us < end_us:
            self.advance(min(STEP_US, end_us - self.t_us))

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
        pieces = min(math.ceil(travel / NEAR_MM), STEP_US // SHORTEST_STEP_US)
        return min(math.ceil(STEP_US / pieces), left_us)

    def _step(self, dt_us: int) -> None:
        t_us, gap = self.t_us + dt_us, self.state.gap_mm
        arm_before = self.arm.true_position_mm()
        self.arm.advance_to(t_us)
        arm_now = self.arm.true_position_mm()
        dt_s = dt_us * 1e-6
        self.state = self.probe.step(t_us, dt_s, arm_now + self._vibration.advance(dt_s))
        self.t_us = t_us
        if self.first_contact is None and self.state.in_contact:
            free_gap = self.state.free_gap_mm
            # The fraction of the step at which the gap became zero.
            fraction = gap / (gap - free_gap) if gap > 0.0 > free_gap else 0.0
            where = arm_before + fraction * (arm_now - arm_before)
            self.first_contact = FirstContact(t_us - dt_us * (1.0 - fraction), where)
