"""How fast the twin's event camera renders 64 markers, against the speed of their motion.

    python benchmarks/camera.py [clean typical noisy]

All markers move to and fro at one speed, images come at 250 Hz, as from the gel. ``real time`` is
simulated over CPU time of one thread, the best of three runs.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from spikingtac.sim.camera.camera import EventCamera
from spikingtac.sim.camera.config import CAMERA_NAMES, load_camera
from spikingtac.sim.optics.states import MarkerImage

SPEEDS_PX_S = (0.0, 12.0, 155.0, 500.0, 1000.0)
GRID = 8
PITCH_PX = 37.0
RADIUS_PX = 7.0
PERIOD_US = 4000
STROKE_PX = 12.0
LENGTH_S = 0.5
REPEATS = 3


def film(speed_px_s: float) -> list[MarkerImage]:
    """Return half a second of markers that move to and fro."""
    axis = (np.arange(GRID) - (GRID - 1) / 2) * PITCH_PX + 159.5
    rest = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    times_us = np.arange(0, round(LENGTH_S * 1e6) + 1, PERIOD_US)
    way = speed_px_s * times_us * 1e-6
    place = STROKE_PX - np.abs(way % (2 * STROKE_PX) - STROKE_PX)
    markers = len(rest)
    shape, radius = np.tile(np.eye(2), (markers, 1, 1)), np.full(markers, RADIUS_PX)
    return [
        MarkerImage(int(t_us), rest + step * np.array([0.958, 0.287]), shape, radius)
        for t_us, step in zip(times_us, place, strict=True)
    ]


def measure(name: str, speed_px_s: float) -> tuple[float, float]:
    """Return (real-time factor, million events a second of simulated time), best of three."""
    camera = EventCamera(load_camera(name), seed=1)
    shots = film(speed_px_s)
    best_s, events = np.inf, 0
    for _ in range(REPEATS):
        camera.settle(shots[0], "random")
        start = time.thread_time()
        events = len(camera.advance(shots))
        best_s = min(best_s, time.thread_time() - start)
    return LENGTH_S / best_s, events / LENGTH_S * 1e-6


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cameras", nargs="*", default=CAMERA_NAMES)
    table = Table("camera", "speed px/s", "real time", "Mev per simulated s", "Mev per CPU s")
    measure("clean", 100.0)  # compiles
    for name in parser.parse_args().cameras:
        for speed_px_s in SPEEDS_PX_S:
            factor, mev_s = measure(name, speed_px_s)
            row = f"{factor:.2f}", f"{mev_s:.3f}", f"{mev_s * factor:.2f}"
            table.add_row(name, f"{speed_px_s:g}", *row)
    Console().print(table)


if __name__ == "__main__":
    main()
