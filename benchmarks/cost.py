"""What the verbs need: peak memory, CPU time, and what an hour of live running costs.

    python benchmarks/cost.py FOLDER

FOLDER holds ``bootstrap.raw``, ``quiet.raw`` and ``mix.raw``. Each verb runs once to fill the
cache of kernels and once to be measured. An hour is the CPU time of the tracker on ``mix.raw``,
decoding included and the start left out, scaled to 3,600 s of data; from a file, so that a camera's
driver is not in it. For a Raspberry Pi 5 (Cortex-A76 at 2.4 GHz) a model of cycles tells what to
expect: this machine's time, times the ratio of clocks, times what such a core does less per cycle.
It was not run there.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.events.open import open_events
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.follow import follow

RATES_HZ = (1_000.0, 350.0)
PRESETS = ("default", "fast")
HOUR_S = 3_600.0
PI_CLOCK_GHZ = 2.4
PI_WORK_PER_CYCLE = 0.4
"""Work per cycle against an x86 server core with 256-bit vectors: half for vectors of 128 bit, and
a fifth less for the rest (assumed)."""
FALLBACK_GHZ = 3.0
WATCH = """
import os, sys, time
begun_s = time.perf_counter()
nowhere = os.open(os.devnull, os.O_WRONLY)
out = [(os.POSIX_SPAWN_DUP2, nowhere, 1)]
pid = os.posix_spawnp(sys.argv[1], sys.argv[1:], os.environ, file_actions=out)
_, status, used = os.wait4(pid, 0)
wall_s, code = time.perf_counter() - begun_s, os.waitstatus_to_exitcode(status)
print([code, wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024])
"""
"""Runs the command that follows it; prints exit code, seconds, CPU seconds, largest memory, MB."""


@dataclass(frozen=True, slots=True)
class Run:
    """What a command used: exit code, time, CPU time of all its processes, largest memory."""

    code: int
    wall_s: float
    cpu_s: float
    peak_mb: float


def main(folder: Path) -> None:
    """Print both tables."""
    with tempfile.TemporaryDirectory() as made:
        calibration = Path(made, "calibration.json")
        print("verb        wall s    CPU s  peak MB")
        for verb, run in verb_costs(folder, calibration, Path(made)):
            failed = f"  exit {run.code}" if run.code else ""
            print(
                f"{verb:10}{run.wall_s:8.2f}{run.cpu_s:9.2f}{run.peak_mb:9.0f}{failed}", flush=True
            )
        clock_ghz = clock()
        slower = clock_ghz / PI_CLOCK_GHZ / PI_WORK_PER_CYCLE
        print(f"\nan hour of live running, CPU time at {clock_ghz:.1f} GHz (Pi: model, not run)")
        print("preset    rate Hz  times real time  CPU s an hour  share of a core  share of a Pi's")
        for preset, rate_hz, share in live_shares(
            folder / "mix.raw", Calibration.load(calibration)
        ):
            print(
                f"{preset:8}{rate_hz:9.0f}{1.0 / share:17.1f}{share * HOUR_S:15.0f}{share:16.1%}"
                f"{share * slower:17.1%}"
            )


def verb_costs(folder: Path, calibration: Path, made: Path) -> Iterator[tuple[str, Run]]:
    """Yield what each verb uses at its second run; the first one compiles.

    Args:
        folder: With the recordings.
        calibration: File to write, which the other verbs use.
        made: Folder for what they write.
    """
    mix, known = str(folder / "mix.raw"), ["--calibration", str(calibration)]
    wanted = {
        "calibrate": [str(folder / "bootstrap.raw"), "-o", str(calibration), "--overwrite"],
        "info": [mix],
        "convert": [mix, str(made / "mix.npz"), "--overwrite"],
        "track": [mix, *known, "-o", str(made / "tracks.npz"), "--overwrite"],
        "contact": [mix, *known, "--quiet", str(folder / "quiet.raw")],
        "touch": [mix, *known],
    }
    for verb, options in wanted.items():
        command = [sys.executable, "-m", "spikingtac", verb, *options]
        measured(command)
        yield verb, measured(command)


def measured(command: list[str]) -> Run:
    """Run a command and return what it used."""
    # Begun by a small process: Linux counts what a process was before it became the command.
    watch = [sys.executable, "-S", "-c", WATCH, *command]
    done = subprocess.run(watch, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
    return Run(*json.loads(done.stdout))


def live_shares(recording: Path, calibration: Calibration) -> Iterator[tuple[str, float, float]]:
    """Yield preset, rate in Hz and the CPU time per time of the recording, decoding included."""
    for preset in PRESETS:
        for rate_hz in RATES_HZ:
            config = load_config(preset).tracking
            cpu_s = duration_s = 0.0
            for _ in range(2):  # the first run compiles or loads
                tracker = make_tracker(config, calibration)
                begun_s = time.process_time()
                frames = [frame.t_us for frame in follow(open_events(recording), tracker, rate_hz)]
                cpu_s = time.process_time() - begun_s
                duration_s = (frames[-1] - frames[0]) * 1e-6
            yield preset, rate_hz, cpu_s / duration_s


def clock() -> float:
    """Return the clock of this machine's first core, GHz, as Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(float(line.split(":")[1]) for line in lines if "cpu MHz" in line) / 1e3
    except (OSError, StopIteration):
        return FALLBACK_GHZ


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python benchmarks/cost.py FOLDER")
    main(Path(sys.argv[1]))
