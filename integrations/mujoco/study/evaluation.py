"""Scripted and learned policies over many seeds, with intervals; and how fast it all is."""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from learn import LearnedPolicy, make
from scipy.stats import binomtest, bootstrap
from spikingtac_mujoco.policies import POLICIES, run
from spikingtac_mujoco.tasks.task import STEP_S, SUBSTEPS

SENSES = {
    "markers": "by touch",
    "blind": "blind",
    "ideal": "ideal sensor",
    "events": "by touch, event camera and tracker",
}
EVENT_SHARE = 5  # With events only one seed of so many is run: they take ten times as long.

# Task -> figures of its episodes besides success and return.
FIGURES = {
    "PegInHole": ("time_s", "aside_mm"),
    "GripWithoutSlip": ("mean_force_n", "excess", "slip_mm"),
    "StopOnTouch": ("overshoot_mm", "time_s"),
}
WARM_STEPS, TIMED_STEPS = 60, 400


def episodes(task: str, sense: str, learned: Path | None, seeds: range) -> list[dict[str, Any]]:
    """Run a policy on a task for these seeds and return what each episode ended with."""
    if learned is not None:
        return [
            run(*pair, seed) for pair in [(make(sense), LearnedPolicy(learned))] for seed in seeds
        ]
    env: Any = gymnasium.make(f"spikingtac/{task}-v0", sense=sense).unwrapped
    policy = POLICIES[task](sense)
    return [run(env, policy, seed) for seed in seeds]


def share(hits: int, count: int) -> str:
    """Return a share with its 95 % interval (Wilson 1927)."""
    found = binomtest(hits, count).proportion_ci(method="wilson")
    return f"{hits / count:.2f} ({found.low:.2f} to {found.high:.2f})"


def mean(values: list[float]) -> str:
    """Return a mean with its 95 % bootstrap interval."""
    if np.ptp(values) == 0.0:
        return f"{values[0]:.2f}"
    found = bootstrap((values,), np.mean, n_resamples=2000, method="percentile", rng=0)
    low, high = found.confidence_interval
    return f"{np.mean(values):.2f} ({low:.2f} to {high:.2f})"


def evaluate(task: str, count: int, learned: Path | None, workers: int) -> list[dict[str, Any]]:
    """Return the rows of a task: by touch, blind, with an ideal sensor, and learned."""
    cases: list[tuple[str, Path | None]] = [(sense, None) for sense in SENSES]
    if task == "GripWithoutSlip" and learned is not None:
        cases.append(("markers", learned))
    rows = []
    with ProcessPoolExecutor(workers) as pool:
        for sense, path in cases:
            seeds = count // EVENT_SHARE if sense == "events" else count
            parts = [range(first, seeds, workers) for first in range(workers)]
            done = pool.map(partial(episodes, task, sense, path), parts)
            found = [row for part in done for row in part]
            row = {"policy": f"{'PPO' if path else 'scripted'}, {SENSES[sense]}", "episodes": seeds}
            row["success"] = share(sum(bool(one["success"]) for one in found), seeds)
            for name in (*FIGURES[task], "return"):
                row[name] = mean([float(one[name]) for one in found])
            rows.append(row)
    return rows


def speed(task: str, sense: str) -> dict[str, Any]:
    """Return steps of 10 ms in a second of CPU time: of the task, and of MuJoCo alone in it."""
    env: Any = gymnasium.make(f"spikingtac/{task}-v0", sense=sense).unwrapped
    policy = POLICIES[task](sense)
    whole_s = steps = 0
    for seed in range(3):
        observation, over = env.reset(seed=seed)[0], False
        policy.reset()
        while not over:
            action, begun_s = policy(observation), time.process_time()
            observation, _, ended, late, _ = env.step(action)
            if seed:  # the first episode warms up
                whole_s, steps = whole_s + time.process_time() - begun_s, steps + 1
            over = ended or late
    begun_s = time.process_time()
    mujoco.mj_step(env.model, env.data, nstep=SUBSTEPS * TIMED_STEPS)
    alone_s = time.process_time() - begun_s
    return {
        "task": f"{task}, {sense}",
        "steps of 10 ms a second": round(steps / whole_s),
        "MuJoCo alone": round(TIMED_STEPS / alone_s),
        "times real time": round(steps * STEP_S / whole_s, 1),
    }


def vector_speed(task: str, environments: int) -> dict[str, Any]:
    """Return steps a second of environments in processes of their own, all together."""
    envs = gymnasium.make_vec(f"spikingtac/{task}-v0", environments, vectorization_mode="async")
    envs.reset(seed=0)
    actions = np.zeros(envs.action_space.shape, np.float32)
    begun_s = 0.0
    for k in range(WARM_STEPS + TIMED_STEPS):
        begun_s = time.perf_counter() if k == WARM_STEPS else begun_s
        envs.step(actions)
    rate = environments * TIMED_STEPS / (time.perf_counter() - begun_s)
    envs.close()
    return {
        "task": f"{task}, markers, {environments} processes",
        "steps of 10 ms a second": round(rate),
    }
