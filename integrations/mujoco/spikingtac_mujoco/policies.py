"""Scripted policies: the same by touch and with an ideal sensor; and what is left to do blind."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from spikingtac_mujoco.tasks import grip, peg, stop_on_touch
from spikingtac_mujoco.tasks.task import STEP_S, Observation

Floats = NDArray[np.float64]
Program = Iterator[list[float]]

BASELINE_STEPS = 5  # Steps at rest whose mean is the skin before a touch.

# Change of the field, px rms over the markers, that is a touch (half of a moving marker's
# error, twenty times that of a marker at rest).
CONTACT_PX = {"ideal": 0.02, "markers": 0.05, "events": 0.05}


class Policy:
    """Runs a program that yields one action for each observation.

    Args:
        sense: What the task observes.
    """

    TASK: ClassVar[str]

    def __init__(self, sense: str) -> None:
        self.sense = sense

    def reset(self) -> None:
        """Begin an episode."""
        self._program: Program | None = None

    def __call__(self, observation: Observation) -> Floats:
        """Return the next action."""
        self.touch = observation["touch"].astype(np.float64)
        self.state = observation["state"].astype(np.float64)
        if self._program is None:
            self._program = self._blind() if self.sense == "blind" else self._by_touch()
        return np.clip(next(self._program), -1.0, 1.0)

    def _by_touch(self) -> Program:
        raise NotImplementedError

    def _blind(self) -> Program:
        raise NotImplementedError

    def _rest(self, actions: int) -> Program:
        """Stand still, and take the mean of the field as that of a skin that feels nothing new."""
        fields = []
        for _ in range(BASELINE_STEPS):
            yield [0.0] * actions
            fields.append(self.touch)
        self._baseline = np.mean(fields, axis=0)

    @property
    def touched(self) -> bool:
        """Whether the field differs from that at rest."""
        change = np.sqrt(((self.touch - self._baseline) ** 2).mean())
        return bool(change > CONTACT_PX[self.sense])


class StopPolicy(Policy):
    """Approach at one speed and stop at the first change; blind: stop at the mean distance."""

    TASK = "StopOnTouch"
    SPEED = 0.045 / stop_on_touch.SPEED_M_S

    def _by_touch(self) -> Program:
        yield from self._rest(1)
        while not self.touched:
            yield [self.SPEED]
        while True:
            yield [0.0]

    def _blind(self) -> Program:
        mean = (stop_on_touch.NEAR_MM + stop_on_touch.FAR_MM) / 2.0 / stop_on_touch.FAR_MM
        while self.state[0] < mean:
            yield [self.SPEED]
        while True:
            yield [0.0]


class GripPolicy(Policy):
    """Lift firmly, then loosen until the shear gives way, and hold a little more than that.

    Shear is the mean of the markers along the finger. As long as nothing slips it is the weight,
    whatever the grip; once the object slips it falls with the grip. Blind: the first force.
    """

    TASK = "GripWithoutSlip"
    # What holds nearly every object at first and blind, and the least grip.
    FIRST_N, LEAST_N = 2.6, 0.25
    SETTLED_S = 0.1  # after the lift, until the shear is that of the weight
    LOOSEN = 2.6  # how fast the grip loosens, a share of it in a second
    # Fall of the shear below its latest peak that is a slip: four times the error of the mean.
    FALL = 0.04
    # Steps in which the peak is looked for, and over which the shear is averaged.
    WINDOW, MEAN = 12, 3
    # Held force over that at which the slip was noticed: the shake adds a tenth to the weight.
    MARGIN = 1.3

    def _to(self, force_n: float) -> list[float]:
        command_n = self.state[0] * grip.FORCE_N[1]
        return [(force_n - command_n) / (grip.FORCE_RATE_N_S * STEP_S)]

    def _shear(self) -> float:
        return float(self.touch[:, 1].mean())

    def _by_touch(self) -> Program:
        while self.state[3] * grip.SCALE[3] < grip.LIFT_S[1] + self.SETTLED_S:
            yield self._to(self.FIRST_N)
        command_n, shears = self.FIRST_N, [self._shear()]
        means = [shears[0]]
        while means[-1] > (1.0 - self.FALL) * max(means[-self.WINDOW :]):
            command_n = max(command_n * (1.0 - self.LOOSEN * STEP_S), self.LEAST_N)
            yield self._to(command_n)
            shears.append(self._shear())
            means.append(float(np.mean(shears[-self.MEAN :])))
        while True:
            yield self._to(self.MARGIN * command_n)

    def _blind(self) -> Program:
        while True:
            yield self._to(self.FIRST_N)


class PegPolicy(Policy):
    """Touch the wall on both sides along x, then along y, and insert in the middle.

    Blind: push down gently along a spiral from where the hole is expected.
    """

    TASK = "PegInHole"
    SPEED, RETURN, DOWN, PRESS = 0.6, 1.0, 0.5, 0.15
    FARTHEST_MM, NEAR_MM = 10.0, 0.05
    # First radius of the search around the middle, and its growth in a turn: by touch, and blind.
    SPIRAL_MM, PITCH_MM, BLIND_PITCH_MM = 0.15, 0.15, 0.5

    @property
    def _place_mm(self) -> Floats:
        return self.state[:3] * peg.FAR_MM

    def _go(self, axis: int, to_mm: float) -> Program:
        while abs(gap := to_mm - self._place_mm[axis]) > self.NEAR_MM:
            yield _along(axis, float(np.clip(gap / 0.5, -self.RETURN, self.RETURN)))

    def _feel(self, axis: int, sign: float, home_mm: float) -> Program:
        """Move along an axis until the wall is felt, remember where, and come back."""
        yield from self._rest(3)
        while not self.touched and abs(self._place_mm[axis] - home_mm) < self.FARTHEST_MM:
            yield _along(axis, sign * self.SPEED)
        self._walls_mm.append(float(self._place_mm[axis]))
        yield from self._go(axis, home_mm)

    def _by_touch(self) -> Program:
        for axis in (0, 1):
            home_mm, self._walls_mm = float(self._place_mm[axis]), []
            for sign in (1.0, -1.0):
                yield from self._feel(axis, sign, home_mm)
            yield from self._go(axis, sum(self._walls_mm) / 2.0)
        yield from self._insert(self.PITCH_MM)

    def _blind(self) -> Program:
        yield from self._insert(self.BLIND_PITCH_MM)

    def _insert(self, pitch_mm: float) -> Program:
        """Move down to the floor of the wide hole, then press and search along a spiral."""
        middle = self._place_mm[:2].copy()
        floor_mm = -peg.WIDE_DEPTH_MM - peg.START_MM
        while self._place_mm[2] > floor_mm + 0.1:
            yield _along(2, -self.DOWN)
        turned, step_mm = 0.0, 1e3 * 0.5 * peg.SPEED_M_S * STEP_S
        while True:
            radius_mm = self.SPIRAL_MM + pitch_mm * turned / (2.0 * np.pi)
            if self._place_mm[2] < floor_mm - 0.5:
                yield _along(2, -self.DOWN)
                continue
            turned += step_mm / radius_mm
            wanted = middle + radius_mm * np.array([np.cos(turned), np.sin(turned)])
            across = np.clip((wanted - self._place_mm[:2]) / 0.2, -1.0, 1.0)
            yield [*across, -self.PRESS]


def _along(axis: int, speed: float) -> list[float]:
    action = [0.0, 0.0, 0.0]
    action[axis] = speed
    return action


# Task -> policy.
POLICIES: dict[str, type[Policy]] = {
    policy.TASK: policy for policy in (PegPolicy, GripPolicy, StopPolicy)
}


def play(task: Any, policy: Any, seed: int) -> Iterator[dict[str, Any]]:
    """Run one episode; yield ``info`` after the reset and after every step.

    It holds what was drawn, the latest ``action`` and the sum of the rewards, ``return``.
    """
    observation, told = task.reset(seed=seed)
    policy.reset()
    told, over = {**told, "return": 0.0}, False
    yield told
    while not over:
        told["action"] = policy(observation)
        observation, reward, ended, late, info = task.step(told["action"])
        told = {**told, **info, "return": told["return"] + reward}
        over = ended or late
        yield told


def run(task: Any, policy: Any, seed: int) -> dict[str, Any]:
    """Run one episode and return its last ``info``."""
    *_, last = play(task, policy, seed)
    return last
