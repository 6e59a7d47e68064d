"""Learn GripWithoutSlip by PPO (Stable-Baselines3), and run what was learned without it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from spikingtac_mujoco.tasks.grip import FORCE_N, FORCE_RATE_N_S
from spikingtac_mujoco.tasks.task import STEP_S

Floats = NDArray[np.float64]

TASK = "spikingtac/GripWithoutSlip-v0"

# Steps of the task for one action (40 ms), and former fields that the policy sees as well.
HOLD_STEPS, PAST = 4, 3
FIELD_SCALE = np.array([1.0, 1.0, 1.0, 2.0])
TARGET_N = (0.2, 4.0)  # Grip force for the actions -1 and 1, N.

# Neurons of each of two layers; logarithm of the first spread of the actions: 0.4 N.
HIDDEN, FIRST_SPREAD = 64, -1.5
ENVIRONMENTS = 4
SETTINGS = {"n_steps": 300, "batch_size": 256, "n_epochs": 8, "learning_rate": 5e-4}


class Features(gymnasium.Wrapper[Any, Any, Any, Any]):
    """The task as a learner sees it.

    An observation is shear along x and y, spread and rms of the last fields, and the robot's
    state; an action is the grip force for 40 ms.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        away = env.unwrapped.sensor.reference_px  # type: ignore[attr-defined]
        away = away - away.mean(axis=0)
        self._outward = away / np.linalg.norm(away, axis=1, keepdims=True)
        size = (1 + PAST) * len(FIELD_SCALE) + env.unwrapped.STATES  # type: ignore[attr-defined]
        self.observation_space = spaces.Box(-100.0, 100.0, (size,), np.float32)

    def reset(self, **given: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(**given)
        self._fields = [self._features(observation["touch"])] * PAST
        return self._seen(observation), info

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Hold a force for 40 ms."""
        wanted_n = np.interp(float(action[0]), [-1.0, 1.0], TARGET_N)
        total = 0.0
        for _ in range(HOLD_STEPS):
            rate = (wanted_n - self._command_n) / (FORCE_RATE_N_S * STEP_S)
            observation, reward, ended, late, info = self.env.step(np.clip([rate], -1.0, 1.0))
            seen, total = self._seen(observation), total + float(reward)
            if ended or late:
                break
        self._fields = [*self._fields[1:], self._features(observation["touch"])]
        return seen, total, ended, late, info

    def _features(self, touch: NDArray[np.float32]) -> Floats:
        spread, rms = (touch * self._outward).sum(axis=1).mean(), np.sqrt((touch**2).mean())
        return np.array([*touch.mean(axis=0), spread, rms]) / FIELD_SCALE

    def _seen(self, observation: Any) -> NDArray[np.float32]:
        self._command_n = float(observation["state"][0]) * FORCE_N[1]
        fields = [*self._fields, self._features(observation["touch"])]
        return np.concatenate([*fields, observation["state"]]).astype(np.float32)


class LearnedPolicy:
    """The mean of a trained policy: three layers, read from an ``.npz``."""

    def __init__(self, path: Path) -> None:
        with np.load(path, allow_pickle=False) as arrays:
            self._layers = [(arrays[f"weight_{k}"], arrays[f"bias_{k}"]) for k in range(3)]

    def reset(self) -> None:
        """Begin an episode."""

    def __call__(self, observation: NDArray[np.float32]) -> Floats:
        """Return the action."""
        values = observation.astype(np.float64)
        for number, (weight, bias) in enumerate(self._layers):
            values = weight @ values + bias
            values = np.tanh(values) if number < 2 else values
        return np.clip(values, -1.0, 1.0)


def make(sense: str = "markers") -> Features:
    """Return the task for a learner."""
    return Features(gymnasium.make(TASK, sense=sense))


def train(path: Path, minutes: float, seed: int = 0) -> dict[str, Any]:
    """Train for so many minutes and write the policy; needs ``spikingtac_mujoco[learn]``."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import SubprocVecEnv

    torch.set_num_threads(1)
    until_s = time.monotonic() + 60.0 * minutes
    environments = SubprocVecEnv([lambda: Monitor(make())] * ENVIRONMENTS)
    network = {"net_arch": [HIDDEN, HIDDEN], "log_std_init": FIRST_SPREAD}
    model = PPO(
        "MlpPolicy", environments, policy_kwargs=network, seed=seed, device="cpu", **SETTINGS
    )
    model.learn(10**9, callback=lambda *_: time.monotonic() < until_s)
    environments.close()
    trunk = model.policy.mlp_extractor.policy_net
    arrays = {
        f"{kind}_{k}": getattr(layer, kind).detach().numpy()
        for k, layer in enumerate((trunk[0], trunk[2], model.policy.action_net))
        for kind in ("weight", "bias")
    }
    np.savez(path, **arrays)
    recent = [episode["r"] for episode in model.ep_info_buffer or ()]
    steps = int(model.num_timesteps) * HOLD_STEPS
    return {"minutes": minutes, "steps": steps, "return_of_the_last": float(np.mean(recent))}
