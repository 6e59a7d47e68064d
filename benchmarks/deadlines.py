"""Deadlines beside a loaded core: steps paced at 1 kHz, with and without ``--realtime``.

    python benchmarks/deadlines.py FOLDER [--seconds 30] [--rounds 3] [--no-priority]

FOLDER holds ``bootstrap.raw`` and ``mix.raw``. A process that never rests loads the second core;
with and without take turns, each in a process of its own. A latency counts from when the window is
complete to the output. The runner waits in a busy loop, as a process that sleeps wakes late; with
priority it sleeps for the first part of its wait, since the system stops what has priority and
never sleeps for 50 ms of every second.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.live import real_time
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.markers.registry import make_tracker
from spikingtac_paper.throughput.stopwatch import PACE_US, in_own_process, paced_run

METHODS = ("default", "fast")
WINDOWS = 3_000
BUSY_S = 0.0004
"""With priority the runner sleeps until so long before a window is complete."""


def main() -> int:
    """Print the table of latencies."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="with bootstrap.raw and mix.raw")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each run")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--methods", nargs="+", default=METHODS, help="presets to run")
    parser.add_argument("--no-priority", action="store_true", help="ask for everything but it")
    args = parser.parse_args()
    saved = args.folder / "calibration.json"
    calibration = Calibration.load(saved) if saved.is_file() else None
    calibration = calibration or calibrate(open_events(args.folder / "bootstrap.raw"))
    found = latencies_us(
        calibration, args.folder, args.methods, (args.rounds, args.seconds), not args.no_priority
    )
    print(f"load {os.getloadavg()[0]:.1f}; {args.rounds} runs of {args.seconds:g} s each")
    print("method   realtime     p50 us    p99 us   p99.9 us     worst   missed")
    for (method, way), every in found.items():
        p50, p99, p999 = np.percentile(every, (50, 99, 99.9))
        missed = (every > PACE_US).mean()
        print(
            f"{method:8} {way:10}{p50:9.0f}{p99:10.0f}{p999:11.0f}{every.max():10.0f}{missed:9.3%}"
        )
    return 0


def latencies_us(
    calibration: Calibration,
    folder: Path,
    methods: Sequence[str],
    runs: tuple[int, float],
    priority: bool = True,
) -> dict[tuple[str, str], np.ndarray]:
    """Return all latencies by method, "with" and "without" real time, beside a loaded core.

    Args:
        calibration: Of the sensor.
        folder: With mix.raw.
        methods: Presets.
        runs: How many, and seconds of each.
        priority: Whether real time asks for priority.
    """
    rounds, seconds = runs
    burner = multiprocessing.get_context("spawn").Process(target=burn, daemon=True)
    burner.start()
    found: dict[tuple[str, str], list[np.ndarray]] = {}
    for number in range(rounds):
        ways = ("without", "with") if number % 2 == 0 else ("with", "without")
        for method in methods:
            for way in ways:
                asked = (way == "with", priority)
                took_us = in_own_process(paced, method, calibration, folder, seconds, asked)
                found.setdefault((method, way), []).append(took_us)
    burner.terminate()
    return {key: np.concatenate(parts) for key, parts in found.items()}


def paced(
    queue: Any,
    method: str,
    calibration: Calibration,
    folder: Path,
    seconds: float,
    asked: tuple[bool, bool],
) -> None:
    """Do one paced run; ``asked`` is for real time at all, and for priority."""
    stream = open_events(folder / "mix.raw")
    taken = [window for window, _ in zip(windows(stream, PACE_US), range(WINDOWS), strict=False)]
    config = load_config(method).tracking
    realtime, priority = asked
    if realtime and priority:
        print(real_time.meet_deadlines().text(), file=sys.stderr)
    elif realtime:
        real_time.exempt_from_collection()
        real_time.lock_memory()
    busy_s = BUSY_S if realtime and priority else float("inf")
    queue.put(paced_run(lambda one: make_tracker(config, one), calibration, taken, seconds, busy_s))


def burn() -> None:
    """Load a core."""
    while True:
        pass


if __name__ == "__main__":
    sys.exit(main())
