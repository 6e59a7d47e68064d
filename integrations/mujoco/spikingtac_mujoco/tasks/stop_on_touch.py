"""``spikingtac/StopOnTouch-v0``: approach an object at an unknown distance and stop."""

from __future__ import annotations

from typing import Any

import numpy as np

from spikingtac_mujoco.tasks.task import PHYSICS_S, Floats, Outcome, TouchTask

# Fastest approach (the paper's).
SPEED_M_S = 0.18
# Of the arm (twin.md, "Braking").
ACCELERATION_M_S2 = 8.0
# From command to motion, in steps of the physics: a controller cycle of a UR3.
LATENCY_STEPS = 8
# Range of distances to the object, and of its place beside the axis, mm.
NEAR_MM, FAR_MM, ASIDE_MM = 15.0, 60.0, 5.0
# Overshoot up to which a stop is a success, and from which the gel is crushed, mm.
ALLOWED_MM, DEEPEST_MM = 1.0, 2.5
# Slower than this for that many steps is a stop.
STILL_M_S, STILL_STEPS = 0.002, 5
TIME_COST, OVERSHOOT_COST, SUCCESS = 0.01, 1.0, 1.0
OBJECTS = ("ball", "rod", "stone", "block")


class StopOnTouch(TouchTask):
    """A finger moves down onto an object and must stop as soon as it touches.

    ``action (1,)``: commanded speed, +1 is 180 mm/s downwards. ``state (3,)``: travel (in 60 mm),
    speed and commanded speed (in 180 mm/s). Reward: -0.01 a step, -1 for each mm of travel after
    the first contact, +1 for a stop within 1 mm of it. It ends with a stop after a contact, or with
    a gel that is crushed (2.5 mm).
    """

    MODEL = "stop_on_touch.xml"
    STATES, STEPS = 3, 400

    def _begin(self, rng: np.random.Generator) -> dict[str, Any]:
        chosen = OBJECTS[int(rng.integers(len(OBJECTS)))]
        self._distance_m = 1e-3 * rng.uniform(NEAR_MM, FAR_MM)
        angle = rng.uniform(0.0, np.pi)
        for number, name in enumerate(OBJECTS):
            body = self.model.body(name)
            aside = 1e-3 * rng.uniform(-ASIDE_MM, ASIDE_MM, 2)
            body.pos[:] = (
                (*aside, -self._distance_m) if name == chosen else (number - 1.5, 5.0, 0.0)
            )
            body.quat[:] = (np.cos(angle / 2.0), 0.0, 0.0, np.sin(angle / 2.0))
        self._commands = [0.0] * LATENCY_STEPS
        self._speed = self._touched_m = self._overshoot_mm = self._told_mm = 0.0
        self._touched, self._still = False, 0
        return {"object": chosen, "distance_mm": 1e3 * self._distance_m}

    def _act(self, action: Floats) -> None:
        self._commands.append(SPEED_M_S * float(action[0]))
        step = ACCELERATION_M_S2 * PHYSICS_S
        self._speed += float(np.clip(self._commands.pop(0) - self._speed, -step, step))
        self.data.ctrl[0] = self._speed

    def _watch(self) -> None:
        reach = float(self.data.joint("reach").qpos[0])
        if not self._touched and self.data.ncon:
            self._touched, self._touched_m = True, reach
        if self._touched:
            self._overshoot_mm = max(self._overshoot_mm, 1e3 * (reach - self._touched_m))

    def _judge(self) -> Outcome:
        before, self._told_mm = self._told_mm, self._overshoot_mm
        still = abs(float(self.data.joint("reach").qvel[0])) < STILL_M_S
        self._still = self._still + 1 if still and self._touched else 0
        stopped, crushed = self._still >= STILL_STEPS, self._overshoot_mm > DEEPEST_MM
        success = stopped and self._overshoot_mm <= ALLOWED_MM
        reward = -TIME_COST - OVERSHOOT_COST * (self._overshoot_mm - before) + SUCCESS * success
        info = {
            "success": success,
            "touched": self._touched,
            "overshoot_mm": self._overshoot_mm,
        }
        return reward, stopped or crushed, info

    def _state(self) -> Floats:
        joint = self.data.joint("reach")
        travel, speed = float(joint.qpos[0]), float(joint.qvel[0])
        return np.array([1e3 * travel / FAR_MM, speed / SPEED_M_S, self._commands[-1] / SPEED_M_S])

    def _lines(self) -> list[str]:
        return [f"overshoot {self._overshoot_mm:.2f} mm"]
