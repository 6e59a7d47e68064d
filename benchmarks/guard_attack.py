"""Attack the guard of an arm: does the arm stand, or is it told that it does not, within 0.2 s?

    python benchmarks/guard_attack.py -o guard.json [--trials 100] [--attacks lag,kill]

The arm is the UR driver on a controller that speaks its protocols on loopback and moves as the twin
does; it moves at 40 mm/s, the guard is a process of its own, and the stream has a window each
millisecond. A trial begins anew with a new controller and a new process. A guard that trips before
its fault, which a busy machine may cause, stops the arm as it should; such a trial is counted
(``early``) and repeated. So is one in which this process, which plays the robot, did not run for
50 ms (``robot_late``). The summary is written after every trial and continued by the same
command. The exit code is 1 where a trial failed.
``guard_quiet.py`` guards without any fault.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from spikingtac.atomic_files import write_json  # noqa: E402
from spikingtac.contact.details import ContactDetails  # noqa: E402
from spikingtac.contact.detector import ContactDetector, DetectorSummary  # noqa: E402
from spikingtac.contact.window import Window  # noqa: E402
from spikingtac.live.factory import Factory  # noqa: E402
from spikingtac.live.guard.contact_loop import Arrival  # noqa: E402
from spikingtac.live.guard.contact_process import ContactProcess  # noqa: E402
from spikingtac.live.real_time import exempt_from_collection, take_precedence  # noqa: E402
from spikingtac.robot.ur import URArm  # noqa: E402
from spikingtac.types import Contact, EventPacket  # noqa: E402
from stand_ins.guarded import LEAP_US  # noqa: E402
from stand_ins.moving_rims import windows  # noqa: E402
from stand_ins.ur_controller import EVERYTHING, URController  # noqa: E402

LIMIT_S = 0.2
"""Within so long of the fault the arm rests, or its not resting is told."""
REST_MM_S = 1.0
SPEED_MM_S = 40.0
FAR_MM = (800.0, 0.0, 0.0)
WINDOW_S = 0.001
PATIENCE_S = 30.0
ROBOT_LATE_S = 0.05
"""The robot's stand-in shares the machine; a real controller does not wait for its turn, s."""
CORES = sorted(os.sched_getaffinity(0))
ROBOT_PRIORITY = 30
"""Real-time priority of the robot's stand-in, above a guard's."""
BUSY_LIMIT_US = 2_000_000
"""The system ends a stand-in that runs so long without a pause: one took the core for good."""
SLOW_S = 0.002
"""What the detector needs for a window of 1 ms under the attack "lag", s."""
DETECTOR_FAULTS = ("lag", "hang", "exception", "ignored")
STREAM_FAULTS = ("leap", "stall")
ATTACKS = (*DETECTOR_FAULTS, *STREAM_FAULTS, "kill", "half-open")
POOL = 200
"""Windows that are made once and given again and again with new times."""


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

    def details(self) -> ContactDetails | None:
        """Return None."""
        return None

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
        yield Arrival((_at(parts[number % POOL], shift_us),), time.monotonic())
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
                Factory(function=stream, arguments={"kind": kind, "note": str(note)}),
                Factory(function=faulty_detector, arguments={"kind": kind, "note": str(note)}),
                Factory(function=URArm, arguments={"host": controller.host}),
            )
        try:
            _wait_until(lambda: _watches(process), process)
            controller.move(FAR_MM, SPEED_MM_S)
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
        except TimeoutError as error:
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
    if phase not in (None, "ready"):
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


def attack(kind: str, trials: int, known: dict[str, Any], folder: Path) -> Iterator[dict[str, Any]]:
    """Make the trials that are missing; yield the summary after each."""
    summary = known or {
        "trials": 0,
        "passed": 0,
        "early": 0,
        "robot_late": 0,
        "times_s": [],
        "failures": [],
    }
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


def main() -> int:
    """Attack, and write the summary after every trial."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("guard.json"))
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--attacks", default=",".join(ATTACKS))
    args = parser.parse_args()
    exempt_from_collection()
    as_a_robot()
    report: dict[str, Any] = {"limit_s": LIMIT_S, "attacks": {}}
    if args.output.is_file():
        report = json.loads(args.output.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        for kind in args.attacks.split(","):
            known = report["attacks"].get(kind, {})
            for summary in attack(kind, args.trials, known, Path(folder)):
                report["attacks"][kind] = summary
                write_json(args.output, report)
            done = report["attacks"][kind]
            times = [value for value in done["times_s"] if value is not None]
            worst = max(times, default=float("nan"))
            print(
                f"{kind}: {done['passed']} of {done['trials']} within {LIMIT_S} s, "
                f"median {np.median(times):.3f} s, worst {worst:.3f} s, {done['early']} early, "
                f"robot late in {done['robot_late']}",
                flush=True,
            )
    return int(any(found["failures"] for found in report["attacks"].values()))


if __name__ == "__main__":
    sys.exit(main())
