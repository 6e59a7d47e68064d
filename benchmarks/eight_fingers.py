"""Eight sensors on one machine: a process for each, read from one place, and one of them killed.

    python benchmarks/eight_fingers.py -o results/eight-fingers [--fingers 8] [--preset default]

Each finger plays the twin's scene finger-torsion (simulated) as fast as it would be recorded and is
tracked at the preset's rate; this process reads all of them 100 times a second. In a second run one
finger's process is killed half-way. The exit code is 1 unless every other finger made every frame,
the last one equal to that of a tracker alone, in both runs.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import spikingtac as st

SCENE, SEED = "finger-torsion", 1
LOOK_S = 0.01
SETTLED_US = 2_000_000
"""Time of the recording until all processes have started and caught up, us."""
PATIENCE_S = 120.0


def prepare(folder: Path, preset: str) -> tuple[st.Finger, list[st.MarkerFrame]]:
    """Render the scene; return a finger that plays it, and the frames of a tracker alone."""
    scene = st.load_scene(SCENE)
    source = st.SceneSource(scene, seed=SEED)
    calibration = st.Calibration(
        reference_px=np.asarray(source.reference_px),
        radius_px=np.asarray(source.radius_px),
        grid=scene.skin.grid,
        size=scene.size,
    )
    calibration.save(folder / "calibration.json")
    with st.create_events(folder / "scene.raw", scene.size) as writer:
        for packet in source:
            writer.write(packet)
    tracking = st.load_config(preset).tracking
    calibration = st.Calibration.load(folder / "calibration.json")  # as a finger reads it
    tracker = st.make_tracker(tracking, calibration)
    alone = list(st.follow(st.open_events(folder / "scene.raw"), tracker, tracking.rate_hz))
    finger = st.Finger(
        source=folder / "scene.raw", calibration=folder / "calibration.json", tracking=tracking
    )
    return finger, alone


def run(finger: st.Finger, alone: list[st.MarkerFrame], count: int, kill: bool) -> dict[str, Any]:
    """Follow so many fingers and return what became of each."""
    begun_s, cpu_s = time.monotonic(), _cpu_s()
    looked_us: list[float] = []
    behind_ms: list[float] = []
    settled_us = alone[0].t_us + SETTLED_US
    killed = "finger 0" if kill else None
    with st.Hand({f"finger {number}": finger for number in range(count)}) as hand:
        while any(one.state in ("starting", "running") for one in hand.health().values()):
            looked_s = time.perf_counter()
            readings = [reading for reading in hand.latest().values() if reading is not None]
            looked_us.append((time.perf_counter() - looked_s) * 1e6)
            behind_ms += [one.behind_ms for one in readings if one.t_us > settled_us]
            if killed and hand.health()[killed].frames > len(alone) // 2:
                os.kill(hand.process_id(killed), signal.SIGKILL)
                killed = None
            if time.monotonic() - begun_s > PATIENCE_S:
                break
            time.sleep(LOOK_S)
        health, latest = hand.health(), hand.latest()
    others = [name for name in health if not (kill and name == "finger 0")]
    equal = [
        (reading := latest[name]) is not None
        and reading.frames == len(alone)
        and np.allclose(reading.displacement_px, alone[-1].displacement_px, atol=1e-5)
        for name in others
    ]
    return {
        "fingers": count,
        "killed": int(kill),
        "frames_each": len(alone),
        "frames_missing": sum(len(alone) - health[name].frames for name in others),
        "last_frames_equal": bool(all(equal)),
        "most_behind_ms": round(max(health[name].most_behind_ms for name in others), 2),
        "behind_ms_p50": round(float(np.median(behind_ms)), 2),
        "behind_ms_p99": round(float(np.percentile(behind_ms, 99)), 2),
        "read_all_us_p50": round(float(np.median(looked_us)), 1),
        "read_all_us_p99": round(float(np.percentile(looked_us, 99)), 1),
        "seconds": round(time.monotonic() - begun_s, 2),
        "cpu_s": round(_cpu_s() - cpu_s, 2),
        "states": sorted({one.state for one in health.values()}),
    }


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    """Measure, write, and say whether nothing is missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=8)
    parser.add_argument("--preset", default="default")
    given = parser.parse_args()
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        finger, alone = prepare(Path(name), given.preset)
        runs = [run(finger, alone, given.fingers, kill) for kill in (False, True)]
    figures = {
        "scene": SCENE,
        "preset": given.preset,
        "rate_hz": finger.tracking.rate_hz,
        "runs": runs,
        "source": "simulated",
        "cpus": os.cpu_count(),
        "machine": platform.machine(),
        "load_before": round(before, 2),
        "load_after": round(os.getloadavg()[0], 2),
    }
    given.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(figures, indent=1)
    (given.output / "figures.json").write_text(text + "\n", encoding="utf-8")
    print(text)
    return 0 if all(r["last_frames_equal"] and not r["frames_missing"] for r in runs) else 1


if __name__ == "__main__":
    sys.exit(main())
