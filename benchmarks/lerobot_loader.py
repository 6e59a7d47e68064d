"""Does LeRobot's own loader open an exported data set, and do its statistics agree with ours?

    python benchmarks/lerobot_loader.py -o results/lerobot --python LEROBOT_ENV/bin/python

LeRobot has pins of its own (torch, NumPy), so it is run by the interpreter of another environment,
which needs nothing of this package. Two recordings are exported with a robot's log; the loader
reads every frame, which is compared with the tracks, and LeRobot computes its statistics anew.
Where torchvision is not installed there, an empty module stands in for it: the data set holds no
images.
The exit code is 1 where anything differs.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from stand_ins.tracks import FIRST_US, circling_tracks  # noqa: E402

FPS = 50
LENGTHS = (2_000, 1_201)
MOVED = "observation.tactile.displacement"
TOLERANCE = 1e-4
"""Largest difference of a minimum, maximum, mean or standard deviation, px: the loader's values are
of single precision."""

LOADER = r"""
import importlib.machinery, importlib.metadata, importlib.util, json, sys, types
import numpy as np

class Empty(types.ModuleType):
    __path__ = []
    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})

stands_in = importlib.util.find_spec("torchvision") is None
if stands_in:
    inner = ("", ".transforms", ".transforms.v2", ".transforms.v2.functional",
             ".transforms.functional", ".io")
    for name in ("torchvision" + end for end in inner):
        module = Empty(name)
        module.__spec__ = importlib.machinery.ModuleSpec(name, None)
        sys.modules[name] = module
        if "." in name:
            above, _, own = name.rpartition(".")
            setattr(sys.modules[above], own, module)

import torch
from lerobot.datasets.compute_stats import aggregate_stats, compute_episode_stats
from lerobot.datasets.lerobot_dataset import CODEBASE_VERSION, LeRobotDataset

root, output = sys.argv[1:]
data = LeRobotDataset("local/tactile", root=root)
frames = [data[index] for index in range(len(data))]
names = [name for name in data.features if name in frames[0]]
columns = {n: np.stack([np.atleast_1d(np.asarray(f[n])) for f in frames]) for n in names}
parts = []
for number in range(data.num_episodes):
    mine = columns["episode_index"][:, 0] == number
    rows = {n: values[mine] for n, values in columns.items()}
    parts.append(compute_episode_stats(rows, {n: data.features[n] for n in rows}))
theirs = aggregate_stats(parts)
worst = max(
    float(np.abs(np.ravel(theirs[n][k]) - np.ravel(data.meta.stats[n][k])).max())
    for n in names for k in ("min", "max", "mean", "std", "count")
)
window = LeRobotDataset(
    "local/tactile", root=root, delta_timestamps={"observation.tactile.displacement": [-0.04, 0.0]}
)
np.savez(output, **columns)
print(json.dumps({
    "lerobot": importlib.metadata.version("lerobot"),
    "torch": torch.__version__,
    "torchvision_stands_in": stands_in,
    "codebase_version": CODEBASE_VERSION,
    "episodes": data.num_episodes,
    "frames": len(data),
    "task": frames[0]["task"],
    "window_shape": list(window[5]["observation.tactile.displacement"].shape),
    "largest_difference_of_statistics": worst,
}))
"""


def export(folder: Path) -> None:
    """Make two recordings with logs, and export them."""
    (folder / "day").mkdir()
    logs = []
    for number, length in enumerate(LENGTHS):
        circling_tracks(estimates=length, off_px=0.1 * number).save(folder / f"day/{number}.npz")
        t_us = FIRST_US + np.arange(0, length * 1_000, 2_000)
        state = np.column_stack((np.sin(t_us / 1e5), np.cos(t_us / 1e5))).astype(np.float32)
        logs.append(folder / f"log{number}.npz")
        np.savez(logs[-1], t_us=t_us, state=state, action=state)
    command = [sys.executable, "-m", "spikingtac", "export", folder / "day", "--to", "lerobot"]
    options = ["-o", folder / "set", "--fps", str(FPS), "--task", "circle", "--log", *logs]
    subprocess.run([*command, *options], check=True, stdout=subprocess.DEVNULL)


def differs(folder: Path) -> int:
    """Return how many frames the loader gives that are not those of the tracks."""
    with np.load(folder / "loaded.npz") as archive:
        moved, episode = archive[MOVED], archive["episode_index"][:, 0]
        frame = archive["frame_index"][:, 0]
    wrong = 0
    for number, length in enumerate(LENGTHS):
        tracks = circling_tracks(estimates=length, off_px=0.1 * number)
        mine = episode == number
        t_us = FIRST_US + frame[mine] * 1_000_000 // FPS
        rows = np.array([np.flatnonzero(tracks.t_us <= t)[-1] for t in t_us])
        expected = tracks.displacement_px[rows].reshape(len(rows), -1)
        wrong += int((moved[mine] != expected).any(axis=1).sum())
    return wrong


def main() -> int:
    """Export, load with LeRobot, compare, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--python", type=Path, required=True, help="interpreter with LeRobot")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export(folder)
        command = [given.python, "-c", LOADER, folder / "set", folder / "loaded.npz"]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        figures = json.loads(done.stdout.splitlines()[-1])
        figures["frames_that_differ"] = differs(folder)
    given.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(figures, indent=1)
    (given.output / "loader.json").write_text(text + "\n", encoding="utf-8")
    print(text)
    fits = figures["largest_difference_of_statistics"] < TOLERANCE
    return 0 if figures["frames_that_differ"] == 0 and fits else 1


if __name__ == "__main__":
    sys.exit(main())
