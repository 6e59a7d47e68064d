"""``python -m spikingtac_mujoco``: show a task with its skin, or export its episodes.

An episode becomes touch, state and action of the scripted policy in a LeRobot data set.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import spikingtac as st
from spikingtac.datasets.export import data_set
from spikingtac.datasets.lerobot import write_lerobot
from spikingtac_mujoco import TASKS
from spikingtac_mujoco.draw import write_gif
from spikingtac_mujoco.policies import POLICIES, play

FPS = 50  # Frames per second of the data set, of 100 a second of the task.


def export_episodes(task: str, folder: Path, count: int, overwrite: bool = False) -> dict[str, Any]:
    """Run the scripted policy by touch and write its episodes; needs ``spikingtac[lerobot]``.

    Raises:
        ConfigError: The folder is in use, or pyarrow is missing.
    """
    env: Any = gymnasium.make(f"spikingtac/{task}-v0").unwrapped
    policy = POLICIES[task](env.sense)
    with tempfile.TemporaryDirectory() as scratch:
        pairs = [_write(env, policy, seed, Path(scratch)) for seed in range(count)]
        tracks, logs = zip(*pairs, strict=True)
        with data_set(folder, "lerobot", overwrite) as partial:
            found = write_lerobot(partial, tracks, logs, FPS, f"{task} (simulated)")
    return {"output": str(folder), **found}


def _write(env: Any, policy: Any, seed: int, scratch: Path) -> tuple[Path, Path]:
    """Run one episode and write its tracks and its log."""
    reference_px, mount = env.sensor.reference_px, env.sensor.mount
    frames, states, actions = [], [], []
    for info in play(env, policy, seed):
        reading, place_px = env.reading, reference_px + env.reading.displacement_px
        moved_px, seen = reading.displacement_px, 1.0 - reading.coasted
        frames.append(
            st.MarkerFrame(reading.t_us, place_px, place_px, moved_px, reading.coasted, seen)
        )
        states.append(env.observation["state"])
        actions.append(info.get("action", np.zeros(env.ACTIONS)))
    calibration = st.Calibration(
        reference_px=reference_px,
        radius_px=np.ones(len(reference_px)),
        grid=mount.grid,
        size=mount.optics.size,
    )
    tracks, log = scratch / f"{seed:04d}.npz", scratch / f"{seed:04d}_log.npz"
    st.Tracks.of(frames, calibration).save(tracks)
    # The action of a frame is the one that was chosen on seeing it.
    t_us, chosen = [frame.t_us for frame in frames[:-1]], np.array(actions[1:], np.float32)
    np.savez(log, t_us=np.array(t_us), state=np.array(states[:-1]), action=chosen)
    return tracks, log


# Steps of a task between two pictures (60 ms), and how often the last picture is repeated.
VIDEO_STEPS, LAST_FRAMES = 6, 12


def show(task: str, sense: str, seed: int, output: Path) -> dict[str, Any]:
    """Run the scripted policy and write an animation of robot and skin."""
    env: Any = gymnasium.make(
        f"spikingtac/{task}-v0", sense=sense, render_mode="rgb_array"
    ).unwrapped
    frames, last = [], {}
    for number, told in enumerate(play(env, POLICIES[task](sense), seed)):
        last = told
        if number % VIDEO_STEPS == 0:
            frames.append(env.render())
    write_gif(output, frames + [env.render()] * LAST_FRAMES)
    env.close()
    return {"output": str(output), "simulated": True, **last}


def main(arguments: list[str] | None = None) -> dict[str, Any]:
    """Run a verb and return its figures."""
    top = argparse.ArgumentParser(prog="python -m spikingtac_mujoco", description=__doc__)
    top.add_argument("verb", nargs="?", choices=["show", "export"], default="show")
    top.add_argument("task", nargs="?", choices=list(TASKS), default="GripWithoutSlip")
    top.add_argument("-o", "--output", type=Path, help="animation, or folder of the data set")
    top.add_argument("--seed", type=int, default=0)
    top.add_argument("--sense", choices=["markers", "events", "ideal", "blind"], default="markers")
    top.add_argument("--episodes", type=int, default=10, help="to export")
    top.add_argument("--overwrite", action="store_true", help="replace an exported data set")
    given = top.parse_args(arguments)
    if given.verb == "export":
        folder = given.output or Path(f"{given.task}_set")
        return export_episodes(given.task, folder, given.episodes, given.overwrite)
    output = given.output or Path(f"{given.task}.gif")
    return show(given.task, given.sense, given.seed, output)


if __name__ == "__main__":
    try:
        print(main())
    except st.SpikingTacError as error:
        sys.exit(f"error: {error}")
