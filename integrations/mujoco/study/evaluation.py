"""Policies over many seeds, with intervals; how fast all is; one fidelity against the other."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from learn import LearnedPolicy, make
from numpy.typing import NDArray
from scipy.stats import binomtest, bootstrap
from spikingtac_mujoco.policies import POLICIES, run
from spikingtac_mujoco.sensor import Reading
from spikingtac_mujoco.tasks.task import STEP_S, SUBSTEPS

import spikingtac as st

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
TIMED_STEPS = 400  # Steps of 10 ms over which MuJoCo alone is timed.


def episodes(task: str, sense: str, learned: Path | None, seeds: range) -> list[dict[str, Any]]:
    """Run a policy on a task for these seeds and return what each episode ended with."""
    env: Any = gymnasium.make(f"spikingtac/{task}-v0", sense=sense).unwrapped
    policy: Any = POLICIES[task](sense)
    if learned is not None:
        env, policy = make(sense), LearnedPolicy(learned)
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


Floats = NDArray[np.float64]

# Episodes of each motion for the table, and others from which the force model is fitted.
SEEDS, FORCE_SEEDS = 3, 6

# Markers that move faster than this tell the delay; those that move less in a step are at rest.
MOVING_PX_S, STILL_PX = 20.0, 0.002
PATH_PX = 1.0  # Path of a marker after which its error has been renewed, px.

# Name -> task, steps, action at a step: objects are pressed in, one is held, a peg is levered.
MOTIONS: dict[str, tuple[str, int, Callable[[int], list[float]]]] = {
    "presses": ("StopOnTouch", 300, lambda k: [0.25 * np.sin(k / 12.0) + 0.06]),
    "holds": ("GripWithoutSlip", 250, lambda k: [0.4 * np.sin(k / 15.0)]),
    "levers": (
        "PegInHole",
        300,
        lambda k: [0.6 * np.sin(k / 25.0), 0.5 * np.cos(k / 40.0), -0.1 * (k > 150)],
    ),
}


def record(motion: str, sense: str, seed: int) -> tuple[list[Reading], st.WrenchSeries]:
    """Run a motion; return its readings, and the same as a labelled series of the force."""
    task, steps, action = MOTIONS[motion]
    env: Any = gymnasium.make(f"spikingtac/{task}-v0", sense=sense).unwrapped
    env.reset(seed=seed)
    readings = []
    for k in range(steps):
        over = env.step(np.array(action(k)))[2]
        readings.append(env.reading)
        if over:
            break
    t_us = np.array([reading.t_us for reading in readings])
    told = np.array([reading.displacement_px for reading in readings])
    force = np.array([reading.skin.force_n for reading in readings])
    return readings, st.WrenchSeries(t_us, env.sensor.reference_px, told, force, "px")


def validate() -> dict[str, Any]:
    """Return the table, and the constants of the markers' errors as measured on events."""
    seeds = range(SEEDS, SEEDS + FORCE_SEEDS)
    series = [record(name, "markers", seed)[1] for name in MOTIONS for seed in seeds]
    model = st.fit_force([one for one in series if one.wrench[:, 2].any()])  # some meet nothing
    rows, watched = [], []
    for name in MOTIONS:
        fine: list[Floats] = []
        for sense in ("events", "markers"):
            runs = [record(name, sense, seed) for seed in range(SEEDS)]
            true = [np.array([reading.true_px for reading in readings]) for readings, _ in runs]
            fine = fine or true
            pairs = zip(true, fine, strict=True)
            off = [np.linalg.norm(a[: len(b)] - b[: len(a)], axis=2).mean() for a, b in pairs]
            row = {"motion": name, "fidelity": sense, **_errors(runs, model)}
            rows.append(row | {"from the finer gel px": round(float(np.mean(off)), 3)})
            watched += [readings for readings, _ in runs] if sense == "events" else []
    return {"rows": rows, "tracker": _tracker(watched)}


def _errors(
    runs: list[tuple[list[Reading], st.WrenchSeries]], model: st.ForceModel
) -> dict[str, float]:
    readings = [reading for run, _ in runs for reading in run]
    true = np.array([reading.true_px for reading in readings])
    off = np.linalg.norm([reading.displacement_px for reading in readings] - true, axis=2)
    told_n = np.concatenate([model.estimate(series)[0] for _, series in runs])
    force_n = np.concatenate([series.wrench for _, series in runs])
    error_n = np.abs(told_n - force_n).mean(axis=0)
    return {
        "largest px": round(float(np.linalg.norm(true, axis=2).max()), 1),
        "mean error px": round(float(off.mean()), 3),
        "95 % px": round(float(np.percentile(off, 95.0)), 3),
        "predicted": round(float(np.mean([reading.coasted for reading in readings])), 5),
        "largest N": round(float(np.linalg.norm(force_n, axis=1).max()), 2),
        "error across N": round(float(error_n[:2].mean()), 4),
        "error down N": round(float(error_n[2]), 3),
    }


def _tracker(runs: list[list[Reading]]) -> dict[str, float]:
    """Return delay, noise, and losses of the tracker behind the event camera."""
    delays, steady, jitter = [], [], []
    for readings in runs:
        true = np.array([reading.true_px for reading in readings])
        error = np.array([reading.displacement_px for reading in readings]) - true
        speed = np.gradient(true, [1e-6 * reading.t_us for reading in readings], axis=0)
        fast = np.abs(speed) > MOVING_PX_S
        if fast.any():
            delays.append(-(error[fast] @ speed[fast]) / (speed[fast] @ speed[fast]))
        moved = np.linalg.norm(np.diff(true, axis=0), axis=2)
        steady.append(error[1:][moved.cumsum(axis=0) > PATH_PX].ravel())
        jitter.append(np.diff(error, axis=0)[moved < STILL_PX].ravel() / np.sqrt(2.0))
    looks = [reading.coasted for readings in runs for reading in readings]
    return {
        "delay_ms": 1e3 * float(np.median(delays)),
        "noise_px": float(np.sqrt((np.concatenate(steady) ** 2).mean())),
        "rest_px": float(np.concatenate(jitter).std()),
        "predicted": float(np.mean(looks)),
        "looks": int(np.size(looks)),
    }
