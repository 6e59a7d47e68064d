"""``spikingtac/GripWithoutSlip-v0``: lift an object of unknown weight and friction, gently."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from spikingtac_mujoco.pad import Mount, add_sensor
from spikingtac_mujoco.tasks.task import PHYSICS_S, Floats, Outcome, TouchTask

# Ranges of what is unknown.
MASS_G, FRICTION = (30.0, 150.0), (0.3, 0.9)
# Range of the grip force, the first one, and how fast it may change, N/s.
FORCE_N, FIRST_N, FORCE_RATE_N_S = (0.2, 8.0), 1.5, 15.0
# Time constant of the gripper.
FORCE_LAG_S = 0.02
# When the hand lifts, and how far.
LIFT_S, LIFT_M = (0.4, 1.0), 0.04
# When it shakes, how fast and how often: up to 1 m/s², a tenth of the weight.
SHAKE_S, SHAKE_M_S, SHAKE_HZ = (2.2, 2.8), 0.04, 4.0
# Slip up to which a grip is a success, and from which the object counts as dropped, mm.
ALLOWED_MM, DROPPED_MM = 3.0, 10.0
FORCE_COST, SLIP_COST, DROP_COST, SUCCESS = 0.01, 0.5, 5.0, 2.0
SCALE = np.array([FORCE_N[1], LIFT_M, 0.1, 3.0])
GRAVITY_M_S2 = 9.81


class GripWithoutSlip(TouchTask):
    """Two fingers, one of them with a sensor, hold a cylinder while the hand lifts and shakes.

    ``action (1,)``: change of the grip force, +1 is 15 N/s. ``state (4,)``: commanded force (in
    8 N), height (in 40 mm) and speed (in 0.1 m/s) of the hand, time (in 3 s). Reward: -0.01 a
    step and N, -0.5 for each mm of slip, -5 for a drop, +2 at the end for a slip of at most 3 mm.
    """

    MODEL = "grip.xml"
    STATES, STEPS = 4, 300
    SKIN = 0.05  # below any object's, which MuJoCo takes then

    def _extend(self, spec: mujoco.MjSpec) -> Sequence[Mount]:
        return [add_sensor(spec, site="other_fingertip", friction=self.SKIN)]

    def _begin(self, rng: np.random.Generator) -> dict[str, Any]:
        mass_g, friction = rng.uniform(*MASS_G), rng.uniform(*FRICTION)
        body, geom = self.model.body("object"), self.model.geom("object")
        body.inertia[:] *= 1e-3 * mass_g / body.mass[0]
        body.mass[:] = 1e-3 * mass_g
        geom.friction[0] = friction
        self._command_n = self._force_n = FIRST_N
        self._slip_mm = self._low_mm = 0.0
        self._sum_n = 0.0
        self.least_n = 1e-3 * mass_g * GRAVITY_M_S2 / (2.0 * friction)
        return {"mass_g": mass_g, "friction": friction, "least_n": self.least_n}

    def _act(self, action: Floats) -> None:
        self._command_n += FORCE_RATE_N_S * PHYSICS_S * float(action[0])
        self._command_n = float(np.clip(self._command_n, *FORCE_N))
        self._force_n += PHYSICS_S / FORCE_LAG_S * (self._command_n - self._force_n)
        self.data.ctrl[:] = self._hand_speed(self.data.time), self._force_n, self._force_n

    @staticmethod
    def _hand_speed(t_s: float) -> float:
        """Return the commanded speed of the hand, m/s: a lift without jerk at its ends, a shake."""
        begin_s, end_s = LIFT_S
        if begin_s < t_s < end_s:
            share = (t_s - begin_s) / (end_s - begin_s)
            return 30.0 * LIFT_M / (end_s - begin_s) * (share * (1.0 - share)) ** 2
        if SHAKE_S[0] < t_s < SHAKE_S[1]:
            return SHAKE_M_S * float(np.sin(2.0 * np.pi * SHAKE_HZ * (t_s - SHAKE_S[0])))
        return 0.0

    def _judge(self) -> Outcome:
        data, before = self.data, self._slip_mm
        low_mm = 1e3 * float(data.joint("lift").qpos[0] - data.joint("object").qpos[2] + 0.025)
        if data.time <= LIFT_S[0]:
            self._low_mm = low_mm
        self._slip_mm = max(self._slip_mm, low_mm - self._low_mm)
        self._sum_n += self._force_n
        dropped = self._slip_mm > DROPPED_MM
        success = self._steps == self.STEPS and self._slip_mm <= ALLOWED_MM
        reward = -FORCE_COST * self._force_n - SLIP_COST * (self._slip_mm - before)
        reward += SUCCESS * success - DROP_COST * dropped
        info = {
            "success": success,
            "slip_mm": self._slip_mm,
            "force_n": self._force_n,
            "mean_force_n": self._sum_n / self._steps,
            "excess": self._force_n / self.least_n,
        }
        return reward, dropped, info

    def _state(self) -> Floats:
        lift = self.data.joint("lift")
        own = [self._command_n, float(lift.qpos[0]), float(lift.qvel[0]), self.data.time]
        return np.array(own) / SCALE

    def _lines(self) -> list[str]:
        grip = f"grip {self._force_n:.2f} N, least {self.least_n:.2f} N"
        return [grip, f"slip {self._slip_mm:.1f} mm"]
