"""How well the fast fidelity stands for the slow one: both on the same motions, in px and N."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from spikingtac_mujoco.sensor import Reading

import spikingtac as st

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
    name = f"{motion}-{seed}"
    return readings, st.WrenchSeries(t_us, env.sensor.reference_px, told, force, "px", name)


def validate() -> dict[str, Any]:
    """Return the table, and the constants of the markers' errors as measured on events."""
    seeds = range(SEEDS, SEEDS + FORCE_SEEDS)
    model = st.fit_force([record(name, "markers", seed)[1] for name in MOTIONS for seed in seeds])
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
