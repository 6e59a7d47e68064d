"""Attack what reads files and what guards an arm; a JSON summary, exit code 1 where anything broke.

    python benchmarks/attack.py files -o files.json [--raw 10000] [--containers 1000] [--kinds evt3]
    python benchmarks/attack.py guard -o guard.json [--trials 100] [--attacks lag,kill]

*files*: every reader is given mutated files. One process at a time reads; one that dies, hangs or
grows is told from its number and replaced. A crash, an error that is not the package's, a broken
promise of a source, more than 30 s, or more than 512 MB above the idle process is a failure. The
same seed gives the same mutants, so that a failure's number is its reproduction
(``--worker KIND FIRST LAST``).

*guard*: does the arm stand within 0.2 s of a fault, or is it told that it does not? The arm is the
UR driver (extra ``[robot]``) on a controller that speaks its protocols on loopback and moves as the
twin does; it moves at 40 mm/s, the guard is a process of its own, and the stream has a window each
millisecond. A trial begins anew with a new controller and a new process. A guard that trips before
its fault, which a busy machine may cause, stops the arm as it should; such a trial is counted
(``early``) and repeated. So is one in which this process, which plays the robot, did not run for
50 ms (``robot_late``).

Summaries are written on the way; the same command goes on where the last one ended.
"""

import argparse
import importlib.util
import json
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from spikingtac.atomic_files import write_json  # noqa: E402
from spikingtac.contact.detector import ContactDetector, DetectorSummary, Window  # noqa: E402
from spikingtac.errors import DeviceError  # noqa: E402
from spikingtac.robot.guard import ContactProcess  # noqa: E402
from spikingtac.robot.guard_loop import Arrival  # noqa: E402
from spikingtac.robot.ur import URArm  # noqa: E402
from spikingtac.stream.real_time import exempt_from_collection, take_precedence  # noqa: E402
from spikingtac.types import Contact, EventPacket  # noqa: E402
from stand_ins.hostile_files import (  # noqa: E402
    CONTAINERS,
    FILE_NAMES,
    KINDS,
    RAW_KINDS,
    mutated,
    outcome,
    seed_file,
)
from stand_ins.moving_rims import windows  # noqa: E402
from stand_ins.ur_controller import EVERYTHING, URController  # noqa: E402

TIME_LIMIT_S = 30.0
LEAP_US = 600_000_000  # A leap of a sensor's clock, ten minutes, us.
MEMORY_LIMIT_MB = 512
GRACE_S = 10.0  # A process that does not heed its own alarm is killed so much later.

WARM_UP = 12  # Mutants that are read before anything is measured: they compile what damage needs.
WARM_UP_LIMIT_S = 600.0

# Mutants after which a process is replaced, so that its peak memory is told for few of them.
BATCH = 500


LIMIT_S = 0.2  # Within so long of the fault the arm rests, or its not resting is told.
REST_MM_S, SPEED_MM_S = 1.0, 40.0
FAR_MM = np.array([800.0, 0.0, 0.0])
WINDOW_S = 0.001
PATIENCE_S = 30.0

# The robot's stand-in shares the machine; a real controller does not wait for its turn, s.
ROBOT_LATE_S = 0.05
CORES = sorted(os.sched_getaffinity(0))
ROBOT_PRIORITY = 30  # Real-time priority of the robot's stand-in, above a guard's.

# The system ends a stand-in that runs so long without a pause: one took the core for good.
BUSY_LIMIT_US = 2_000_000
SLOW_S = 0.002  # What the detector needs for a window of 1 ms under the attack "lag", s.
DETECTOR_FAULTS = ("lag", "hang", "exception", "ignored")
STREAM_FAULTS = ("leap", "stall")
ATTACKS = (*DETECTOR_FAULTS, *STREAM_FAULTS, "kill", "half-open")
POOL = 200  # Windows that are made once and given again and again with new times.


def attack_files(kind: str, count: int, known: dict[str, Any] | None) -> Iterator[dict[str, Any]]:
    """Read ``count`` mutants of a kind, after those that are known; yield what became of them."""
    found: dict[str, Any] = known or {
        "mutants": 0, "read": 0, "refused": 0, "slowest_s": 0.0, "peak_mb": 0.0, "failures": [],
    }  # fmt: skip
    while found["mutants"] < count:
        first = found["mutants"]
        found["mutants"] = _batch(kind, first, min(first + BATCH, count), found)
        yield found


def _batch(kind: str, first: int, last: int, found: dict[str, Any]) -> int:
    """Let one process read mutants; return the number of the next one to read."""
    command = [sys.executable, __file__, "files", "--worker", kind, str(first), str(last)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    reached = first
    with child.stdout as lines:
        select.select([lines], [], [], WARM_UP_LIMIT_S)
        lines.readline()  # kernels are compiled
        begun = time.monotonic()
        while True:
            ready, _, _ = select.select([lines], [], [], TIME_LIMIT_S + GRACE_S)
            line = lines.readline() if ready else ""
            if not line:
                break
            record = json.loads(line)
            reached, begun = record["mutant"] + 1, time.monotonic()
            _count(record, found)
    if child.poll() is None and time.monotonic() - begun >= TIME_LIMIT_S:
        child.kill()
    code = child.wait()
    if reached < last:
        _count({"mutant": reached, "outcome": f"process ended with {code}"}, found)
        reached += 1
    return reached


def _count(record: dict[str, Any], found: dict[str, Any]) -> None:
    found["slowest_s"] = max(found["slowest_s"], record.get("seconds", 0.0))
    found["peak_mb"] = max(found["peak_mb"], record.get("grown_mb", 0.0))
    if record["outcome"] in ("read", "refused"):
        found[record["outcome"]] += 1
    if record["outcome"] not in ("read", "refused") or record.get("grown_mb", 0) > MEMORY_LIMIT_MB:
        found["failures"].append(record)


def work(kind: str, first: int, last: int) -> int:
    """Read mutants and tell about each on a line of its own."""
    signal.signal(signal.SIGALRM, _late)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sound = seed_file(kind, folder)
        outcome(sound)  # kernels are compiled before anything is measured
        data = sound.read_bytes()
        path = folder / "m" / FILE_NAMES[kind]
        path.parent.mkdir()
        for mutant in range(WARM_UP):  # those of salvage, too
            path.write_bytes(mutated(data, np.random.default_rng(mutant)))
            _outcome(path)
        print("{}", flush=True)
        idle_mb = _peak_mb()
        for mutant in range(first, last):
            path.write_bytes(mutated(data, np.random.default_rng(mutant)))
            begun = time.monotonic()
            record: dict[str, Any] = {"mutant": mutant, "outcome": _outcome(path)}
            record |= {"seconds": time.monotonic() - begun, "grown_mb": _peak_mb() - idle_mb}
            print(json.dumps(record), flush=True)
    return 0


def _outcome(path: Path) -> str:
    signal.setitimer(signal.ITIMER_REAL, TIME_LIMIT_S)
    try:
        return outcome(path)
    except Exception:
        return traceback.format_exc(limit=-3)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _late(number: int, frame: Any) -> None:
    raise TimeoutError(f"more than {TIME_LIMIT_S:g} s (process {os.getpid()})")


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@dataclass(frozen=True)
class Fault:
    """What goes wrong in the guarding process.

    Attributes:
        kind: One of the attacks.
        note: File into which the time of the fault is written, on the monotonic clock, s; the
            fault is due as soon as there is one of the same name with the ending ``.due``.
    """

    kind: str
    note: str

    def due(self) -> bool:
        """Return whether it is time: the guard watches, and the arm moves."""
        return due_file(self.note).exists()

    def begins(self) -> None:
        """Write down that it goes wrong now, once."""
        path = Path(self.note)
        if not path.exists():
            path.write_text(repr(time.monotonic()), encoding="utf-8")


def due_file(note: str | Path) -> Path:
    """Return the file that makes a fault due."""
    return Path(f"{note}.due")


class FaultyDetector:
    """The published detector's place, cheap, with a fault in one window."""

    in_contact = False

    def __init__(self, fault: Fault) -> None:
        self._fault, self._count = fault, 0

    def update(self, window: Window) -> Contact | None:
        """Go wrong once it is due, and decide on no contact otherwise."""
        self._count += 1
        kind = self._fault.kind
        if kind not in DETECTOR_FAULTS or not self._fault.due():
            return None
        self._fault.begins()
        if kind == "exception":
            raise RuntimeError("the detector failed")
        if kind == "ignored":
            return Contact(self._count * 1_000, 1, 0)
        time.sleep(SLOW_S if kind == "lag" else PATIENCE_S)
        return None

    def reset(self) -> None:
        """Count on: the first window only compiles."""

    def summary(self) -> DetectorSummary:
        """Return what it does."""
        return DetectorSummary(rule="goes wrong when it is told to")


def faulty_detector(kind: str, note: str) -> ContactDetector:
    """Make the detector; the guarding process calls this."""
    return FaultyDetector(Fault(kind, note))


def stream(kind: str, note: str) -> Iterator[Arrival]:
    """Yield a window each millisecond; stall or leap where the fault is one of the stream's."""
    fault, pool = Fault(kind, note), windows(POOL, seed=2)
    parts = [window[0] if isinstance(window, tuple) else window for window in pool]
    begun_s, number = time.monotonic(), 0
    while True:
        wrong = kind in STREAM_FAULTS and fault.due()
        if wrong:
            fault.begins()
        if wrong and kind == "stall":
            time.sleep(PATIENCE_S)
        shift_us = number * 1_000 + (LEAP_US if wrong else 0)
        time.sleep(max(begun_s + (number + 1) * WINDOW_S - time.monotonic(), 0.0))
        yield Arrival(_at(parts[number % POOL], shift_us), time.monotonic())
        number += 1


def _at(window: EventPacket, start_us: int) -> EventPacket:
    t = window.t - window.t_start_us + start_us
    return replace(window, t=t, t_start_us=start_us, t_end_us=start_us + 1_000)


def as_a_robot() -> None:
    """Let this thread and those that it starts run as the robot does, which waits for nobody.

    It leaves the last core to the guard, which keeps to that one: a controller is another machine.
    """
    os.sched_setaffinity(0, CORES[:-1] or CORES)
    resource.setrlimit(resource.RLIMIT_RTTIME, (BUSY_LIMIT_US, resource.RLIM_INFINITY))
    take_precedence(ROBOT_PRIORITY)


@contextmanager
def as_a_user() -> Iterator[None]:
    """Start a process from an ordinary thread that may use every core, as a user's is."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.sched_setaffinity(0, CORES)
    resource.setrlimit(resource.RLIMIT_RTTIME, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    try:
        yield
    finally:
        as_a_robot()


def trial(kind: str, folder: Path) -> dict[str, Any]:
    """Attack one guard; return after how long the arm rested, and after how long it was told."""
    note = folder / "fault"
    note.unlink(missing_ok=True)
    due_file(note).unlink(missing_ok=True)
    with URController() as controller:
        with as_a_user():
            process = ContactProcess(
                partial(stream, kind=kind, note=str(note)),
                partial(faulty_detector, kind=kind, note=str(note)),
                partial(URArm, host=controller.host),
            )
        try:
            _wait_until(lambda: _watches(process), process)
            with controller._lock:
                controller._advance()
                far_mm = controller.twin.true_position_mm() + FAR_MM
                controller.twin.move_linear(far_mm, SPEED_MM_S)
            _wait_until(
                lambda: _watches(process) and _speed(controller) > 0.95 * SPEED_MM_S, process
            )
            if kind == "ignored":
                controller.deaf_to = EVERYTHING
            time.sleep(float(np.random.default_rng().uniform(0.0, 0.1)))
            due_file(note).touch()
            if kind in ("kill", "half-open"):
                note.write_text(repr(time.monotonic()), encoding="utf-8")
            if kind == "kill":
                process.kill()
            controller.half_open = kind == "half-open"
            found = _follow(controller, process, note)
        except (TimeoutError, DeviceError) as error:  # the robot has stopped by itself, too
            found = {"early": True, "why": str(error)}
        finally:
            controller.half_open = False
            controller.deaf_to = frozenset()
            process.close()
    return found


def _watches(process: ContactProcess) -> bool:
    """Return whether the guard watches.

    Raises:
        TimeoutError: It has tripped before its fault.
    """
    phase = process.status().get("phase")
    if phase not in (None, "starting", "ready"):
        raise TimeoutError(f"{phase}: {process.status().get('reason')}")
    return phase == "ready"


def _wait_until(done: Any, process: ContactProcess) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not done():
        if time.monotonic() > until_s or not process.alive():
            raise TimeoutError(f"not ready: {process.status()}")
        time.sleep(0.005)


def _follow(controller: URController, process: ContactProcess, note: Path) -> dict[str, Any]:
    """Wait for rest or word, and return both times since the fault."""
    rested_s: float | None = None
    told_s: float | None = None
    looked_s, longest_s = time.monotonic(), 0.0
    until_s = time.monotonic() + PATIENCE_S
    status: dict[str, Any] = {}
    while time.monotonic() < until_s and rested_s is None and told_s is None:
        status = process.status()
        now_s = time.monotonic()
        looked_s, longest_s = now_s, max(longest_s, now_s - looked_s)
        if _speed(controller) < REST_MM_S:
            rested_s = time.monotonic()
        if status.get("stop_failure"):
            told_s = status["at_s"]
        time.sleep(0.001)
    text = note.read_text(encoding="utf-8") if note.exists() else ""
    if not text or (rested_s is not None and rested_s < float(text)):
        return {"early": True, "why": f"{status.get('health')}: {status.get('reason')}"}
    if longest_s > ROBOT_LATE_S:
        return {"robot_late": True}
    fault_s = float(text)
    found = {"rested_s": rested_s, "told_s": told_s}
    found = {name: None if at is None else at - fault_s for name, at in found.items()}
    time.sleep(0.05)  # the reason follows the stop
    told = {name: process.status().get(name) for name in ("health", "stop_failure")}
    orders_s = [round(at - fault_s, 4) for at in controller.stop_times_s if at > fault_s]
    return {**found, **told, "orders_s": orders_s}


def _speed(controller: URController) -> float:
    return float(np.linalg.norm(controller.twin.speed_mm_s()))


def judged(kind: str, found: dict[str, Any]) -> bool:
    """Return whether a trial passed."""
    times = [found[name] for name in ("rested_s", "told_s") if found.get(name) is not None]
    return bool(times) and min(times) <= LIMIT_S


def attack_guard(
    kind: str, trials: int, known: dict[str, Any], folder: Path
) -> Iterator[dict[str, Any]]:
    """Make the trials that are missing; yield the summary after each."""
    none = dict.fromkeys(("trials", "passed", "early", "robot_late"), 0)
    summary: dict[str, Any] = known or {**none, "times_s": [], "failures": []}
    while summary["trials"] < trials:
        found = trial(kind, folder)
        if found.get("early"):
            summary["early"] += 1
            summary["early_why"] = found["why"][:200]
        elif found.get("robot_late"):
            summary["robot_late"] += 1
        else:
            summary["trials"] += 1
            passed = judged(kind, found)
            summary["passed"] += passed
            times = [found[name] for name in ("rested_s", "told_s") if found[name] is not None]
            summary["times_s"].append(round(min(times), 4) if times else None)
            if not passed:
                summary["failures"].append(found)
        yield summary
        if summary["early"] + summary["robot_late"] > 3 * trials:
            return


def files(args: argparse.Namespace) -> int:
    """Attack the readers asked for and write the summary; return the exit code."""
    if args.worker:
        return work(args.worker[0], int(args.worker[1]), int(args.worker[2]))
    limits = {"seconds": TIME_LIMIT_S, "memory_mb": MEMORY_LIMIT_MB}
    report = known_report(args.output) or {"limits": limits, "kinds": {}}
    for kind in known_names(args.kinds, (*RAW_KINDS, *CONTAINERS)):
        count = args.raw if kind in RAW_KINDS else args.containers
        for found in attack_files(kind, count, report["kinds"].get(kind)):
            report["kinds"][kind] = found
            write_json(args.output, report)
        print(kind, {k: v for k, v in report["kinds"][kind].items() if k != "failures"}, flush=True)
    failures = sum(len(found["failures"]) for found in report["kinds"].values())
    mutants = sum(found["mutants"] for found in report["kinds"].values())
    print(f"{failures} failures of {mutants} mutants; {args.output}")
    return int(failures > 0 or mutants == 0)


def guard(args: argparse.Namespace) -> int:
    """Make the trials asked for and write the summary after each; return the exit code."""
    if importlib.util.find_spec("rtde_control") is None:
        sys.exit("ur-rtde is missing, so no arm can be guarded: pip install 'spikingtac[robot]'")
    exempt_from_collection()
    as_a_robot()
    report = known_report(args.output) or {"limit_s": LIMIT_S, "attacks": {}}
    kinds = known_names(args.attacks, ATTACKS)
    with tempfile.TemporaryDirectory() as folder:
        for kind in kinds:
            known = report["attacks"].get(kind, {})
            for summary in attack_guard(kind, args.trials, known, Path(folder)):
                report["attacks"][kind] = summary
                write_json(args.output, report)
            tell(kind, report["attacks"][kind])
    done = [report["attacks"][kind] for kind in kinds]
    return int(any(found["failures"] or not found["trials"] for found in done))


def tell(kind: str, done: dict[str, Any]) -> None:
    """Print what became of an attack."""
    times = [value for value in done["times_s"] if value is not None] or [float("nan")]
    print(
        f"{kind}: {done['passed']} of {done['trials']} within {LIMIT_S} s, "
        f"median {np.median(times):.3f} s, worst {max(times):.3f} s, {done['early']} early, "
        f"robot late in {done['robot_late']}",
        flush=True,
    )
    if not done["trials"]:
        print(f"{kind}: no trial reached its fault: {done.get('early_why', 'the robot was late')}")


def known_report(path: Path) -> dict[str, Any] | None:
    """Return the summary of a run that was interrupted, or None."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def known_names(given: str, known: tuple[str, ...]) -> list[str]:
    """Return the names in a list with commas; end the program where one is unknown."""
    names = given.split(",")
    if unknown := set(names) - set(known):
        sys.exit(f"unknown: {', '.join(sorted(unknown))} (valid: {', '.join(known)})")
    return names


def main() -> int:
    """Read the command line and attack."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    verbs = parser.add_subparsers(required=True)
    one = verbs.add_parser("files", help="mutated files for every reader")
    one.add_argument("-o", "--output", type=Path, default=Path("files.json"))
    one.add_argument("--raw", type=int, default=10_000, help="mutants per RAW encoding")
    one.add_argument("--containers", type=int, default=1_000, help="mutants per container")
    one.add_argument("--kinds", default=",".join(KINDS))
    one.add_argument("--worker", nargs=3, metavar=("KIND", "FIRST", "LAST"))
    one.set_defaults(run=files)
    other = verbs.add_parser("guard", help="faults while an arm moves")
    other.add_argument("-o", "--output", type=Path, default=Path("guard.json"))
    other.add_argument("--trials", type=int, default=100)
    other.add_argument("--attacks", default=",".join(ATTACKS))
    other.set_defaults(run=guard)
    args = parser.parse_args()
    return args.run(args)


if __name__ == "__main__":
    import attack  # by its name: the guard's process imports what it is made of

    raise SystemExit(attack.main())
