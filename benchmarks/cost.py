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

import os
import resource
import subprocess
import sys
import tempfile
import time
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


def main(folder: Path) -> None:
    """Print both tables."""
    with tempfile.TemporaryDirectory() as made:
        calibration = Path(made, "calibration.json")
        verbs(folder, calibration, Path(made))
        hours(folder / "mix.raw", Calibration.load(calibration))


def verbs(folder: Path, calibration: Path, made: Path) -> None:
    """Print peak memory and CPU time of each verb."""
    mix, known = str(folder / "mix.raw"), ["--calibration", str(calibration)]
    wanted = {
        "calibrate": [str(folder / "bootstrap.raw"), "-o", str(calibration), "--overwrite"],
        "info": [mix],
        "convert": [mix, str(made / "mix.npz"), "--overwrite"],
        "track": [mix, *known, "-o", str(made / "tracks.npz"), "--overwrite"],
        "contact": [mix, *known, "--quiet", str(folder / "quiet.raw")],
        "touch": [mix, *known],
    }
    print("verb        wall s    CPU s  peak MB")
    for verb, options in wanted.items():
        command = [sys.executable, "-m", "spikingtac", verb, *options]
        measured(command)
        code, used, wall_s = measured(command)
        cpu_s, peak_mb = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024
        failed = f"  exit {os.waitstatus_to_exitcode(code)}" if code else ""
        print(f"{verb:10}{wall_s:8.2f}{cpu_s:9.2f}{peak_mb:9.0f}{failed}", flush=True)


def measured(command: list[str]) -> tuple[int, resource.struct_rusage, float]:
    """Run a command; return its status, what it used, and how long it took, s."""
    begun_s = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, code, used = os.wait4(process.pid, 0)
    process.returncode = code
    return code, used, time.perf_counter() - begun_s


def hours(recording: Path, calibration: Calibration) -> None:
    """Print the CPU time of an hour, here and by the model for a Raspberry Pi."""
    clock_ghz = clock()
    slower = clock_ghz / PI_CLOCK_GHZ / PI_WORK_PER_CYCLE
    print(f"\nan hour of live running, from CPU time at {clock_ghz:.1f} GHz (Pi: model, not run)")
    print("preset    rate Hz  times real time  CPU s an hour  share of a core  share of a Pi's")
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
            share = cpu_s / duration_s
            print(
                f"{preset:8}{rate_hz:9.0f}{1.0 / share:17.1f}{share * HOUR_S:15.0f}{share:16.1%}"
                f"{share * slower:17.1%}"
            )


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
