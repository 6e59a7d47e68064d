"""``python -m spikingtac_mujoco``: show a task with its skin, or export its episodes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import gymnasium

import spikingtac as st
from spikingtac_mujoco import TASKS
from spikingtac_mujoco.draw import write_gif
from spikingtac_mujoco.export import export_episodes
from spikingtac_mujoco.policies import POLICIES, play

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
