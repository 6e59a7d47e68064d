"""``spikingtac/PegInHole-v0``: find the middle of a hole by touching its wall, and insert."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from spikingtac_mujoco.pad import Mount
from spikingtac_mujoco.tasks.task import Floats, Outcome, TouchTask

# Radii of the peg's tip, of the bore and of the wide hole above it, mm.
PEG_MM, BORE_MM, WIDE_MM = 2.0, 2.3, 6.0
# Depth of the wide hole, of the bore below, and of the tip in an inserted peg, mm.
WIDE_DEPTH_MM, BORE_DEPTH_MM, DEPTH_MM = 5.0, 10.0, 9.0
# Largest distance of the hole's axis from where it is expected, along x and along y, mm.
ASIDE_MM = 3.0
# From the middle of the pad to the end of the tip, and where the tip starts (top is 0), mm.
REACH_MM, START_MM = 42.0, -3.0
# Radius of the shaft between the pads, and how deep it lies in each, mm.
GRASP_MM, PRESSED_MM = 4.0, 0.5
# Name, radius, both ends from the middle of the pad, mm, and whether it collides.
PARTS = (
    ("shaft", GRASP_MM, 7.0, -7.0, 0),
    ("tip", PEG_MM, -10.0, PEG_MM - REACH_MM, 1),
)
SPEED_M_S = 0.015
# Force between tip and plate that ends an episode, N.
OVERLOAD_N = 10.0
TIME_COST, PROGRESS, SUCCESS, FAILURE_COST = 0.005, 0.1, 5.0, 2.0
FAR_MM = 6.0


class PegInHole(TouchTask):
    """A gripper holds a peg in a wide hole; the bore that it must enter is in the middle of it.

    ``action (3,)``: speed of the hand along x, y and z, 1 is 15 mm/s. ``state (6,)``: place of the
    hand from its start (in 6 mm) and its speed (in 15 mm/s). Reward: -0.005 a step, 0.1 for each mm
    nearer to the inserted peg, +5 for a tip 4 mm deep in the bore, -2 for more than 10 N or a peg
    that was torn out of the grip; each of these ends the episode.
    """

    MODEL = "peg.xml"
    STATES, ACTIONS, STEPS = 6, 3, 800

    def _extend(self, spec: mujoco.MjSpec) -> Sequence[Mount]:
        plate, capsule = spec.body("fingertip_pad"), mujoco.mjtGeom.mjGEOM_CAPSULE
        plate.gravcomp = 1.0
        axis = 1e-3 * (GRASP_MM - PRESSED_MM)
        for name, radius_mm, top_mm, bottom_mm, collides in PARTS:
            plate.add_geom(
                name=name,
                type=capsule,
                size=(1e-3 * radius_mm, 0.0, 0.0),
                fromto=(0.0, 1e-3 * top_mm, axis, 0.0, 1e-3 * bottom_mm, axis),
                contype=collides,
                conaffinity=collides,
                mass=0.003,
                friction=(0.3, 0.002, 0.0001),
                rgba=(0.85, 0.65, 0.35, 1.0),
            )
        return ()

    def _begin(self, rng: np.random.Generator) -> dict[str, Any]:
        self._hole_mm = rng.uniform(-ASIDE_MM, ASIDE_MM, 2)
        while np.hypot(*self._hole_mm) > ASIDE_MM:
            self._hole_mm = rng.uniform(-ASIDE_MM, ASIDE_MM, 2)
        self.model.body("plate").pos[:2] = 1e-3 * self._hole_mm
        self._load_n, self._distance_mm = 0.0, self._away_mm(self._hand_mm())
        return {"hole_mm": self._hole_mm.tolist()}

    def _hand_mm(self) -> Floats:
        return 1e3 * np.array([self.data.joint(name).qpos[0] for name in "xyz"])

    def _away_mm(self, hand_mm: Floats) -> float:
        """Return how far the hand is from where it would have inserted the peg, mm."""
        return float(np.linalg.norm(hand_mm - [*self._hole_mm, -DEPTH_MM - START_MM]))

    def _act(self, action: Floats) -> None:
        self.data.ctrl[:] = SPEED_M_S * action

    def _judge(self) -> Outcome:
        hand_mm, wrench = self._hand_mm(), np.zeros(6)
        self._load_n = 0.0
        for number in range(self.data.ncon):
            mujoco.mj_contactForce(self.model, self.data, number, wrench)
            self._load_n += float(np.linalg.norm(wrench[:3]))
        before, self._distance_mm = self._distance_mm, self._away_mm(hand_mm)
        tip_mm = START_MM + float(hand_mm[2])
        aside_mm = float(np.hypot(*(hand_mm[:2] - self._hole_mm)))
        success = tip_mm < -DEPTH_MM and aside_mm < PEG_MM
        failed = self._load_n > OVERLOAD_N or not self.reading.skin.in_contact
        reward = -TIME_COST + PROGRESS * (before - self._distance_mm)
        reward += SUCCESS * success - FAILURE_COST * failed
        info = {
            "success": success,
            "aside_mm": aside_mm,
            "load_n": self._load_n,
        }
        return reward, success or failed, info

    def _state(self) -> Floats:
        speed = [self.data.joint(name).qvel[0] / SPEED_M_S for name in "xyz"]
        return np.concatenate((self._hand_mm() / FAR_MM, speed))

    def _lines(self) -> list[str]:
        return [f"plate pushes with {self._load_n:.2f} N"]
