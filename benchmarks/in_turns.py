"""Decoding, steps and errors of two versions of this project, in turns.

    git worktree add ../before 4cc7516        # the state before input was checked
    python benchmarks/in_turns.py ../before ../shared/data/v2e [--rounds 21]

The other version is a checkout or a wheel. The folder of recordings holds ``bootstrap.raw`` and
``mix.raw``; a calibration that is given is not made again. Each version works in a process of its
own that stays warm; they take turns within each round, in an order that changes, so that a machine
whose speed drifts slows both, and only the time on the processor counts. Printed is the median of
the rounds' ratios, this checkout's time over the other's, with a 95 % interval (bootstrap over
rounds). The aims: 1.05 for decoding, 1.03 for steps; the exit code is 1 where a median is above its
aim. Errors need ``mix.truth.npz``. Beside other work differences of some per cent cannot be seen
so; ``checks.py`` takes turns within one process.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
ENCODINGS = ("evt2", "evt21", "evt3")
PRESETS = ("default", "fast")

# Largest ratio that counts as met: checks cost at most 5 % and 3 %, errors are as before.
AIMS = (
    {f"decode {name}": 1.05 for name in ENCODINGS}
    | {f"step {name}": 1.03 for name in PRESETS}
    | {f"error {name}": 1.01 for name in PRESETS}
)
EVENTS = 2_000_000
STEP_US = 1_000
STEPS = 1_500
RESAMPLES = 2_000


@dataclass(frozen=True, slots=True)
class Ratio:
    """A task's median times, and the median of the rounds' ratios with its 95 % interval."""

    this: float
    other: float
    median: float
    low: float
    high: float


def main() -> int:
    """Run both versions in turns and print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("other", type=Path, help="checkout or wheel to compare with")
    parser.add_argument("recordings", type=Path, help="folder with bootstrap.raw and mix.raw")
    parser.add_argument("--calibration", type=Path, help="of these recordings, if it is there")
    parser.add_argument("--rounds", type=int, default=21)
    parser.add_argument("--only", default="", help="tasks whose name begins so: decode, step fast")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        return work(args.recordings, args.calibration, args.only)
    above = 0
    for task, ratio in compare(
        args.other, args.recordings, args.calibration, args.rounds, args.only
    ).items():
        aim = AIMS[task]
        above += ratio.median > aim
        print(
            f"{task:14} {ratio.this:12.4g} against {ratio.other:12.4g}: "
            f"{ratio.median:.3f} ({ratio.low:.3f} to {ratio.high:.3f}), aim {aim}"
        )
    return int(above > 0)


def compare(
    other: Path, recordings: Path, calibration: Path | None, rounds: int, only: str = ""
) -> dict[str, Ratio]:
    """Return this version's time of each task over the other's.

    Args:
        other: Checkout, or wheel.
        recordings: Folder with bootstrap.raw and mix.raw.
        calibration: Of these recordings, if it is there.
        rounds: Turns of each version.
        only: Tasks whose name begins so.
    """
    given = [str(recordings.resolve()), "--only", only]
    if calibration:
        given += ["--calibration", str(calibration.resolve())]
    with ExitStack() as stack:
        sources = {"this": ROOT / "src", "other": other.resolve() / "src"}
        if other.is_file():
            sources["other"] = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            zipfile.ZipFile(other).extractall(sources["other"])
        workers = {name: start(path, given) for name, path in sources.items()}
        for worker in workers.values():
            stack.callback(worker.kill)
        return ratios(turns(workers, rounds))


def turns(
    workers: dict[str, subprocess.Popen[str]], count: int
) -> list[dict[str, dict[str, float]]]:
    """Let warm workers take turns; return what each took for every task, round by round."""
    for name, worker in workers.items():
        print(f"{name}: warm after {answer(worker)['warm_s']:.0f} s", file=sys.stderr, flush=True)
    rounds: list[dict[str, dict[str, float]]] = []
    for number in range(count):
        order = list(workers) if number % 2 == 0 else list(workers)[::-1]
        found: dict[str, dict[str, float]] = {}
        for name in order:
            stream = workers[name].stdin
            assert stream is not None
            print("go", file=stream, flush=True)
            found[name] = answer(workers[name])
        rounds.append(found)
    return rounds


def start(source: Path, given: list[str]) -> subprocess.Popen[str]:
    """Start the worker of a side; ``source`` is the folder that holds the package."""
    environment = os.environ | {"PYTHONPATH": str(source), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, __file__, str(source), *given, "--worker"]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True)


def answer(worker: subprocess.Popen[str]) -> dict[str, float]:
    """Return the next line of a worker."""
    assert worker.stdout is not None
    line = worker.stdout.readline()
    if not line:
        raise SystemExit(f"a worker ended with {worker.wait()}")
    return json.loads(line)


def ratios(rounds: list[dict[str, dict[str, float]]]) -> dict[str, Ratio]:
    """Return each task's ratio."""
    rng, found = np.random.default_rng(0), {}
    for task in rounds[0]["this"]:
        this, other = (
            np.array([took[name][task] for took in rounds]) for name in ("this", "other")
        )
        ratio = this / other
        drawn = np.median(rng.choice(ratio, (RESAMPLES, len(ratio))), axis=1)
        low, high = np.percentile(drawn, (2.5, 97.5))
        middles = (float(np.median(values)) for values in (this, other, ratio))
        found[task] = Ratio(*middles, float(low), float(high))
    return found


def work(recordings: Path, calibration: Path | None, only: str) -> int:
    """Time every task once for each line of the standard input: s for decoding, us for a step."""
    begun_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        tasks = decoding(Path(folder)) if "decode".startswith(only[:6]) else {}
        if "step".startswith(only[:4]) or "error".startswith(only[:5]):
            tasks |= stepping(recordings, calibration)
        tasks = {name: task for name, task in tasks.items() if name.startswith(only)}
        for task in tasks.values():
            task()
        print(json.dumps({"warm_s": time.perf_counter() - begun_s}), flush=True)
        for _ in sys.stdin:
            print(json.dumps({name: task() for name, task in tasks.items()}), flush=True)
    return 0


def decoding(folder: Path) -> dict[str, Callable[[], float]]:
    """Return what times the reading of two million events in each encoding."""
    import spikingtac as st
    from spikingtac.events import create_events

    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, EVENTS, EVENTS))
    x, y = (rng.integers(0, 320, EVENTS).astype(np.uint16) for _ in range(2))
    packet = st.EventPacket(x, y, rng.random(EVENTS) < 0.5, t, 0, int(t[-1]) + 1, (320, 320))
    tasks: dict[str, Callable[[], float]] = {}
    for name in ENCODINGS:
        path = folder / f"{name}.raw"
        with create_events(path, (320, 320), encoding=name) as writer:
            writer.write(packet)

        def read(path: Path = path) -> float:
            begun_s = time.thread_time()
            assert sum(len(packet) for packet in st.open_events(path)) == EVENTS
            return time.thread_time() - begun_s

        tasks[f"decode {name}"] = read
    return tasks


def stepping(recordings: Path, known: Path | None) -> dict[str, Callable[[], float]]:
    """Return what times a step of each preset (a window cut, absorbed and estimated) and errs."""
    import spikingtac as st

    calibration = (
        st.Calibration.load(known)
        if known
        else st.calibrate(st.open_events(recordings / "bootstrap.raw"))
    )
    packets = list(st.open_events(recordings / "mix.raw"))
    tasks: dict[str, Callable[[], float]] = {}
    for name in PRESETS:

        def run(name: str = name) -> float:
            tracker = st.make_tracker(st.load_config(name).tracking, calibration)
            return _median_step_us(tracker, packets)

        tasks[f"step {name}"] = run
        if (recordings / "mix.truth.npz").is_file():
            tracker = st.make_tracker(st.load_config(name).tracking, calibration)
            error_px = _error_px(tracker, packets, recordings / "mix.truth.npz")
            tasks[f"error {name}"] = lambda error_px=error_px: error_px
    return tasks


def _error_px(tracker: Any, packets: list[Any], truth: Path) -> float:
    """Return the mean error over the whole recording."""
    import spikingtac as st

    known = dict(np.load(truth))
    errors_px: list[float] = []
    for window in st.windows(st.PacketSource(packets, packets[0].size), STEP_US):
        tracker.absorb(window)
        frame = tracker.estimate(window.t_end_us)
        at = min(np.searchsorted(known["marker_t_us"], frame.t_us), len(known["marker_px"]) - 1)
        off_px = frame.detected_px - known["marker_px"][at]
        errors_px.append(float(np.linalg.norm(off_px, axis=1).mean()))
    return float(np.mean(errors_px))


def _median_step_us(tracker: Any, packets: list[Any]) -> float:
    """Return what a step takes in the median."""
    import spikingtac as st

    steps_us: list[float] = []
    begun_s = time.thread_time()
    for window in st.windows(st.PacketSource(packets, packets[0].size), STEP_US):
        tracker.absorb(window)
        tracker.estimate(window.t_end_us)
        now_s = time.thread_time()
        steps_us.append((now_s - begun_s) * 1e6)
        begun_s = now_s
        if len(steps_us) == STEPS:
            break
    return float(np.median(steps_us))


if __name__ == "__main__":
    sys.exit(main())
