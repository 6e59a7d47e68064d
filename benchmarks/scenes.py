"""How fast the twin renders: each of the ten trajectories, against real time.

    python benchmarks/scenes.py [SCENE ...] [--seed 0]

``wall`` is one run as a user gets it (the gel's thread runs ahead of the camera), the first run of
all left out, since it compiles. The two CPU columns are measured apart, one after the other; on
two idle cores the wall time approaches the larger of them. ``real time`` is the scene's length
over the wall time, ``at best`` over that larger CPU time: on a busy machine only the latter counts.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.source import SceneSource


@dataclass(frozen=True)
class Timing:
    """Seconds that one scene takes."""

    scene_s: float
    events: int
    wall_s: float
    gel_cpu_s: float
    camera_cpu_s: float

    @property
    def real_time(self) -> float:
        """Scene's length over wall time."""
        return self.scene_s / self.wall_s

    @property
    def at_best(self) -> float:
        """Scene's length over the CPU time of the slower part."""
        return self.scene_s / max(self.gel_cpu_s, self.camera_cpu_s)


def measure(name: str, seed: int) -> Timing:
    """Time one scene."""
    scene = catalog.load(name)
    start = time.perf_counter()
    source = SceneSource(scene, seed)
    events = sum(len(packet) for packet in source)
    wall_s = time.perf_counter() - start
    apart = SceneSource(scene, seed)
    start = time.thread_time()
    images = [image for _, image in apart.frames()]
    gel_cpu_s = time.thread_time() - start
    start = time.thread_time()
    for _ in apart.render_images(images):
        pass
    camera_cpu_s = time.thread_time() - start
    return Timing((source.t_end_us or 0) * 1e-6, events, wall_s, gel_cpu_s, camera_cpu_s)


def main() -> None:
    """Print one row for each scene, and the mean."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_Raw)
    parser.add_argument("scenes", nargs="*", default=list(catalog.TRAJECTORIES))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    for _ in SceneSource(catalog.load(arguments.scenes[0]), duration_s=1.0):
        pass
    timings = {name: measure(name, arguments.seed) for name in arguments.scenes}
    table = Table(box=None, pad_edge=False)
    table.add_column("scene", no_wrap=True)
    for column in ("length s", "events M", "wall s", "gel s", "camera s", "real time", "at best"):
        table.add_column(column, justify="right")
    for name, timing in timings.items():
        row = (timing.scene_s, timing.events * 1e-6, timing.wall_s, timing.gel_cpu_s)
        rest = (timing.camera_cpu_s, timing.real_time, timing.at_best)
        table.add_row(name, *(f"{value:.2f}" for value in (*row, *rest)))
    total_s = sum(timing.scene_s for timing in timings.values())
    wall = total_s / sum(timing.wall_s for timing in timings.values())
    console = Console()
    console.print(table)
    console.print(f"all together: {wall:.2f} times real time")


class _Raw(argparse.RawDescriptionHelpFormatter):
    pass


if __name__ == "__main__":
    main()
