"""Episodes as a LeRobot data set: touch, state and action of the scripted policy."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import spikingtac as st
from spikingtac.datasets.export import ExportConfig, export
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
        told = f"{task} (simulated)"
        config = ExportConfig(
            sources=tracks, form="lerobot", output=folder, fps=FPS, task=told, logs=logs
        )
        return export(config, overwrite)


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
        size=mount.finger.optics.size,
    )
    tracks, log = scratch / f"{seed:04d}.npz", scratch / f"{seed:04d}_log.npz"
    st.Tracks.of(frames, calibration).save(tracks)
    # The action of a frame is the one that was chosen on seeing it.
    t_us, chosen = [frame.t_us for frame in frames[:-1]], np.array(actions[1:], np.float32)
    np.savez(log, t_us=np.array(t_us), state=np.array(states[:-1]), action=chosen)
    return tracks, log
