"""One long recording on two cores: how much faster than on one, and how good at the seams.

    python benchmarks/long_recording.py -o results/long-recording --minutes 60

Seconds (simulated) in which the whole skin of the twin is rubbed to and fro and let go, once a
second, at 1.5 million events per second, are repeated for as long as asked. `spikingtac track`
follows them as a whole, then cut every 60 s by one and by two workers. The error against the truth
is told next to the cuts (the second after each) and elsewhere. CPU seconds say what cutting costs,
whatever else the machine does; the largest memory of the command and of each of its processes is
told (Linux). The exit code is 1 where the seams err by more than the rest. An hour needs 50 GB in
the folder for temporary files and some 35 minutes on two idle cores; without `one_worker` 22.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events import create_events
from spikingtac.sim.camera.camera import EventCamera
from spikingtac.sim.optics.projection import Optics
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.truth import image_radius_px
from spikingtac.tracks import Tracks
from spikingtac.types import EventPacket

SEED = 3
RUBS_HZ = 6.2
"""Circles per second, chosen for 1.5 million events per second."""
CIRCLE_MM = 0.33
MOVING_S, RAMP_S = 0.85, 0.1
"""Each second: so long in motion, with so long to begin and to end; the rest at rest."""
IMAGE_US = 1_000
LOOP_US = 4_000_000
"""What is rendered; the skin rests at both ends, so that it can be repeated."""
AFTER_CUT_US = 1_000_000
RUNS = {"whole": 0, "one_worker": 1, "two_workers": 2}
"""Run -> workers; the first one does not cut."""
LOOK_S = 0.2
"""Time between two looks at the memory of the processes."""


def render() -> tuple[EventPacket, np.ndarray, Calibration]:
    """Return the events of a loop, the markers ``(n, m, 2)`` at every image, and a calibration."""
    scene = catalog.load("quiet").with_camera("typical")
    optics = Optics(scene.optics, seed=scene.skin.serial)
    camera = EventCamera(scene.camera.resolve(scene.size), SEED, serial=scene.skin.serial)
    rest = scene.skin.at_rest()

    def image(t_us: int) -> Any:
        now_s = t_us * 1e-6
        left_s = min(now_s % 1.0, MOVING_S - now_s % 1.0)
        reach_mm = CIRCLE_MM * min(max(left_s / RAMP_S, 0.0), 1.0)
        angle = 2.0 * np.pi * RUBS_HZ * now_s
        shift_mm = reach_mm * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
        return optics.project(replace(rest, t_us=t_us, marker_mm=rest.marker_mm + shift_mm))

    images = [image(t_us) for t_us in range(0, LOOP_US + 1, IMAGE_US)]
    camera.settle(images[0], scene.history.references)
    events = EventPacket.concatenate([camera.advance([one]) for one in images[1:]])
    calibration = Calibration(
        reference_px=np.asarray(images[0].center_px),
        radius_px=np.asarray(image_radius_px(images[0])),
        grid=scene.skin.grid,
        size=scene.size,
    )
    return events, np.array([one.center_px for one in images]), calibration


def write(folder: Path, events: EventPacket, loops: int) -> None:
    """Write the loop so many times."""
    with create_events(folder / "long.raw", events.size) as writer:
        for number in range(loops):
            shift_us = number * LOOP_US
            writer.write(
                replace(
                    events,
                    t=events.t + shift_us,
                    t_start_us=shift_us,
                    t_end_us=shift_us + LOOP_US,
                )
            )


def timed(folder: Path, name: str, *options: str) -> dict[str, Any]:
    """Track with the command line; return seconds, CPU seconds and what it said."""
    command = [sys.executable, "-m", "spikingtac", "track", folder / "long.raw", "--json"]
    command += ["--calibration", folder / "calibration.json", "-o", folder / f"{name}.npz"]
    before, begun = _cpu_s(), time.perf_counter()
    process = subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    peaks_mb: dict[int, float] = {}
    watch = threading.Thread(target=_watch, args=(process, peaks_mb))
    watch.start()
    said, _ = process.communicate()
    seconds = time.perf_counter() - begun
    watch.join()
    if process.returncode:
        raise SystemExit(f"{name}: track ended with {process.returncode}")
    summary = json.loads(said)
    kept = ("estimates", "pieces", "mended", "seam_mean_px", "seam_worst_px")
    figures: dict[str, Any] = {
        "seconds": round(seconds, 2),
        "cpu_s": round(_cpu_s() - before, 2),
        "peak_mb": round(peaks_mb.pop(process.pid, 0.0), 1),
        "workers_peak_mb": sorted((round(mb, 1) for mb in peaks_mb.values()), reverse=True),
    }
    return figures | {key: summary[key] for key in kept if key in summary}


def _watch(process: subprocess.Popen[bytes], peaks_mb: dict[int, float]) -> None:
    """Note the largest memory in use of a process and of its workers, MB, while it runs."""
    while process.poll() is None:
        for pid in _family(process.pid):
            with contextlib.suppress(OSError, StopIteration):  # it has ended meanwhile
                lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
                peak = next(line for line in lines if line.startswith("VmHWM:"))
                peaks_mb[pid] = int(peak.split()[1]) / 1024
        time.sleep(LOOK_S)


def _family(pid: int) -> list[int]:
    """Return a process and all that descend from it."""
    found = [pid]
    for parent in found:
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{parent}/task").iterdir():
                children = (task / "children").read_text(encoding="utf-8").split()
                found += [int(child) for child in children]
    return found


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def errors(path: Path, marker_px: np.ndarray) -> dict[str, float]:
    """Return the mean error and its 95th percentile, px; next to the cuts and elsewhere."""
    tracks = Tracks.load(path)
    step, within = np.divmod(tracks.t_us % LOOP_US, IMAGE_US)
    share = (within / IMAGE_US)[:, None, None]
    true_px = marker_px[step] * (1 - share) + marker_px[step + 1] * share
    error_px = np.linalg.norm(tracks.detected_px - true_px, axis=2)
    near = np.zeros(len(tracks.t_us), bool)
    for seam_us in tracks.meta.get("seams", {}).get("cuts_us", []):
        near |= (tracks.t_us >= seam_us) & (tracks.t_us < seam_us + AFTER_CUT_US)
    found = {}
    for name, chosen in (("at_seams", near), ("elsewhere", ~near)):
        if chosen.any():
            found[f"{name}_mean_px"] = round(float(error_px[chosen].mean()), 4)
            found[f"{name}_p95_px"] = round(float(np.percentile(error_px[chosen], 95)), 4)
    return found


def measure(folder: Path, minutes: float, cut_s: float, runs: list[str]) -> dict[str, Any]:
    """Make the runs and return the figures."""
    events, marker_px, calibration = render()
    calibration.save(folder / "calibration.json")
    loops = max(round(minutes * 60e6 / LOOP_US), 4)
    write(folder, replace(events, t_start_us=0, t_end_us=LOOP_US), 2)
    timed(folder, "warm", "--cut-s", "5", "--workers", "1")  # kernels are compiled here
    write(folder, events, loops)
    figures: dict[str, Any] = {
        "recording_s": loops * LOOP_US / 1e6,
        "mev_s": round(len(events) / LOOP_US, 3),
        "cut_s": cut_s,
    }
    for name in runs:
        workers = RUNS[name]
        options = ("--cut-s", str(cut_s), "--workers", str(workers)) if workers else ()
        figures[name] = timed(folder, name, *options)
        figures[name] |= errors(folder / f"{name}.npz", marker_px)
        (folder / f"{name}.npz").unlink()
    two = figures["two_workers"]
    for name in runs:
        if name != "two_workers":
            speedup = figures[name]["seconds"] / two["seconds"]
            figures[f"speedup_over_{name}"] = round(speedup, 3)
    if "whole" in runs:
        figures["cpu_of_cutting"] = round(two["cpu_s"] / figures["whole"]["cpu_s"], 3)
    return figures


def main() -> int:
    """Measure, write, and say whether the seams are as good as the rest."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--cut-s", type=float, default=60.0)
    alone = ["whole", "one_worker"]
    parser.add_argument(
        "--runs", nargs="+", choices=alone, default=alone, help="what two workers are compared with"
    )
    given = parser.parse_args()
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        figures = measure(Path(name), given.minutes, given.cut_s, [*given.runs, "two_workers"])
    figures["source"] = "simulated"
    figures["cpus"], figures["machine"] = os.cpu_count(), platform.machine()
    figures["load_before"], figures["load_after"] = round(before, 2), round(os.getloadavg()[0], 2)
    given.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(figures, indent=1)
    (given.output / "figures.json").write_text(text + "\n", encoding="utf-8")
    print(text)
    found = figures["two_workers"]
    return 0 if found.get("at_seams_mean_px", 0.0) <= 1.1 * found["elsewhere_mean_px"] else 1


if __name__ == "__main__":
    sys.exit(main())
