"""Ten thousand frames at 1 kHz to an independent DDS participant on this machine: is one lost?

    python benchmarks/ros2_loopback.py -o results/ros2 [--frames 10000] [--reliable]

Tracks of 64 markers are published by ``spikingtac ros2``, best effort unless told otherwise, and
read by a process of its own whose types come from ROS 2 Humble's published definitions (rosbags).
Every field is compared. The exit code is 1 where a frame is lost or differs. Needs [ros2].
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from spikingtac.ros2.messages import FIELD  # noqa: E402
from stand_ins import ros2_subscriber  # noqa: E402
from stand_ins.tracks import circling_tracks  # noqa: E402

DOMAIN = "77"
KIND = "sensor_msgs/msg/PointCloud2"


def measure(folder: Path, frames: int, reliable: bool) -> dict[str, object]:
    """Publish, read, and compare."""
    tracks = circling_tracks(estimates=frames, px_per_mm=8.0)
    tracks.save(folder / "tracks.npz")
    options = ["reliable"] if reliable else []
    given = [DOMAIN, "rt/tactile/field", KIND, str(folder / "read.npz"), str(frames), "60"]
    reader = subprocess.Popen(
        [sys.executable, ros2_subscriber.__file__, *given, *options], stdout=subprocess.PIPE
    )
    assert reader.stdout is not None
    reader.stdout.readline()
    command = [sys.executable, "-m", "spikingtac", "ros2", folder / "tracks.npz", "--json"]
    flags = ["--reliable"] if reliable else []
    done = subprocess.run(
        [*command, "--domain", DOMAIN, "--wait-s", "60", *flags], stdout=subprocess.PIPE, check=True
    )
    reader.wait()
    with np.load(folder / "read.npz") as archive:
        t_ns, data = archive["t_ns"], archive["data"]
    number = (t_ns - t_ns[0]) // 1_000_000 if len(t_ns) else t_ns
    cloud = np.frombuffer(data.tobytes(), FIELD).reshape(len(data), -1)
    pairs = (
        (cloud["u"], tracks.position_px[number, :, 0]),
        (cloud["v"], tracks.position_px[number, :, 1]),
        (cloud["du"], tracks.displacement_px[number, :, 0]),
        (cloud["dv"], tracks.displacement_px[number, :, 1]),
        (cloud["valid"] == 1, ~tracks.coasted[number]),
    )
    return {
        "frames": frames,
        "received": len(t_ns),
        "lost": frames - len(t_ns),
        "equal": bool(all(np.array_equal(*pair) for pair in pairs)),
        "reliability": "reliable" if reliable else "best effort",
        "publisher": json.loads(done.stdout),
    }


def main() -> int:
    """Measure, write, and say whether everything arrived."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--reliable", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        figures = measure(Path(name), given.frames, given.reliable)
    figures |= {"cpus": os.cpu_count(), "load": round(os.getloadavg()[0], 2)}
    given.output.mkdir(parents=True, exist_ok=True)
    name = "reliable.json" if given.reliable else "best-effort.json"
    text = json.dumps(figures, indent=1)
    (given.output / name).write_text(text + "\n", encoding="utf-8")
    print(text)
    return 0 if figures["lost"] == 0 and figures["equal"] else 1


if __name__ == "__main__":
    sys.exit(main())
