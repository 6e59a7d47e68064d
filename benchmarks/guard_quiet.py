"""Guard an arm for an hour in which nothing goes wrong, beside a busy machine: does it trip?

    python benchmarks/guard_quiet.py -o quiet.json [--minutes 60] [--burners 2]

The guard is the published one: the UR driver, the detector that is the default, a window each
millisecond, a process of its own that takes real-time priority and a core, as it does wherever it
is permitted (root, or limits.conf). The robot is a stand-in with the other cores and the priority
of a machine of its own; the burners are ordinary processes. After a trip the guard begins again.

A stall meter with a higher priority runs on every core (``stall_meter.py``). A trip is excused
where, just before it, the machine itself stalled for as long as the guard's limit that was passed:
nothing that runs on this machine could have looked; or, where the controller was gone, the robot's
stand-in was held up. A stall that began after the trip excuses nothing. Every other trip is false.
The exit code is 1 where one was. The record is written after every trip and every minute.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from guard_attack import WINDOW_S, as_a_robot, as_a_user, stream

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from stall_meter import Stall, StallNotes, stall_notes  # noqa: E402

from spikingtac.atomic_files import write_json  # noqa: E402
from spikingtac.contact.detector import ContactDetector  # noqa: E402
from spikingtac.contact.registry import DetectionConfig, make_detector  # noqa: E402
from spikingtac.live.factory import Factory  # noqa: E402
from spikingtac.live.guard.contact_loop import Arrival  # noqa: E402
from spikingtac.live.guard.contact_process import ContactProcess  # noqa: E402
from spikingtac.live.real_time import exempt_from_collection  # noqa: E402
from spikingtac.robot.ur import URArm  # noqa: E402
from spikingtac.robot.watchdog import WatchdogConfig  # noqa: E402
from stand_ins.moving_rims import calibration, windows  # noqa: E402
from stand_ins.ur_controller import URController  # noqa: E402

LIMITS_S = {"stale": WatchdogConfig().stale_s, "overload": WatchdogConfig().backlog_s}
"""What a stall must last at least to excuse a trip, s."""
ROBOT_LIMIT_S = 0.025
"""The same for everything else, as where the robot's own watchdog stopped the arm, s."""
BEFORE_S = 0.3
"""A stall counts for a trip that is told so long after it, s: silence, stop and news take less."""
POLL_S = 0.01
ROBOT_LATE_S = 0.025
"""The robot's stand-in runs in this process. Where that did not run for so long, the arm's
controller was not there, which is a fault."""
SEEN_S = 0.1
"""Longest time between two looks that counts as watched, s."""
RECORD_S = 60.0
PATIENCE_S = 60.0
BURNED = 100_000
"""Numbers that a burner sorts again and again."""
NOTED_WINDOWS = 80
"""How many of the guard's last windows are noted for a trip."""


def noted_stream(note: str) -> Iterator[Arrival]:
    """Yield a window each millisecond; write the last ones down at the end.

    A noted window is when it came, on the monotonic clock, s, how late that was, s, and what CPU
    time the guard's loop had used by then, s: a loop that did not run used none.
    """
    begun_s = time.monotonic()
    last: deque[tuple[float, float, float]] = deque(maxlen=NOTED_WINDOWS)
    try:
        for number, arrival in enumerate(stream("none", os.devnull)):
            at_s = arrival.received_s
            last.append((at_s, at_s - begun_s - (number + 1) * WINDOW_S, time.thread_time()))
            yield arrival
    finally:
        Path(note).write_text(json.dumps(list(last)), encoding="utf-8")


def real_detector() -> ContactDetector:
    """Make the project's detector; the guarding process calls this."""
    return make_detector("motion", DetectionConfig(), [calibration()], windows(1000, seed=1))


def burn() -> None:
    """Keep a core busy, at the lowest ordinary priority."""
    os.nice(19)
    values = np.random.default_rng().random(BURNED)
    while True:
        np.sort(values)


@contextmanager
def burners(count: int) -> Iterator[None]:
    """Keep so many processes busy while the context lasts."""
    spawn = multiprocessing.get_context("spawn")
    processes = [spawn.Process(target=burn, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.terminate()


def judged(status: dict[str, Any], stalls: list[Stall]) -> dict[str, Any]:
    """Return a trip with the stalls around it, and whether none of them excuses it."""
    limit_s = LIMITS_S.get(status["health"], ROBOT_LIMIT_S)
    longest_s = max((stall.length_s for stall in stalls), default=0.0)
    return {
        "health": status["health"],
        "reason": status["reason"],
        "limit_ms": 1e3 * limit_s,
        "stalls_ms": [
            {
                "core": stall.core,
                "length_ms": round(1e3 * stall.length_s, 1),
                "ended_before_ms": round(1e3 * (status["at_s"] - stall.end_s), 1),
            }
            for stall in stalls
        ],
        "longest_stall_ms": round(1e3 * longest_s, 1),
        "false": longest_s < limit_s,
    }


class QuietHour:
    """Guards without any fault, again after each trip, and keeps the record.

    Args:
        minutes: How long.
        notes: Of the stall meters.
        output: The record.
        folder: For the guard's notes of late windows.
    """

    def __init__(self, minutes: float, notes: StallNotes, output: Path, folder: Path) -> None:
        self._begun_s = time.monotonic()
        self._end_s = self._begun_s + 60.0 * minutes
        self._notes, self._output, self._note_file = notes, output, folder / "late.json"
        self._watched_s, self._loads = 0.0, [os.getloadavg()[0]]
        self._trips: list[dict[str, Any]] = []
        self._last: dict[str, Any] = {}
        self._written_s = self._robot_late_s = 0.0

    def run(self) -> int:
        """Guard until the end and return the number of false trips."""
        while time.monotonic() < self._end_s:
            with URController() as controller:
                with as_a_user():
                    process = ContactProcess(
                        Factory(function=noted_stream, arguments={"note": str(self._note_file)}),
                        Factory(function=real_detector),
                        Factory(function=URArm, arguments={"host": controller.host}),
                    )
                self._note_file.unlink(missing_ok=True)
                status = self._watch(process)
                closing_s = time.monotonic()
                process.close()
                status = {**status, "closing_s": time.monotonic() - closing_s}
                if "health" not in status:  # it failed before it watched: nothing was guarded
                    print(f"no start: {status.get('reason', 'no answer')}", flush=True)
                elif status["phase"] != "ready":
                    self._note(status)
        self._write()
        return sum(trip["false"] for trip in self._trips)

    def _watch(self, process: ContactProcess) -> dict[str, Any]:
        until_s = time.monotonic() + PATIENCE_S
        while not process.status().get("phase") and time.monotonic() < until_s:
            time.sleep(POLL_S)
        looked_s, status = time.monotonic(), process.status()
        gaps_s: deque[float] = deque([0.0], maxlen=int(BEFORE_S / POLL_S))
        while status.get("phase") == "ready" and time.monotonic() < self._end_s:
            time.sleep(POLL_S)
            status = process.status()
            now_s = time.monotonic()
            gaps_s.append(now_s - looked_s - POLL_S)
            # A program that did not run has seen nothing: its pause is not time of watching.
            self._watched_s, looked_s = self._watched_s + min(now_s - looked_s, SEEN_S), now_s
            self._last = status if status["phase"] == "ready" else self._last
            if now_s > self._written_s + RECORD_S:
                self._loads.append(os.getloadavg()[0])
                self._write()
        self._robot_late_s = max(gaps_s)
        return status

    def _note(self, status: dict[str, Any]) -> None:
        # What came after the trip excuses nothing: the end of a guard keeps a core busy, too.
        stalls = self._notes.between(status["at_s"] - BEFORE_S, status["at_s"])
        trip = {"after_min": round(self._watched_s / 60.0, 2), **judged(status, stalls)}
        trip["closing_s"] = round(status["closing_s"], 2)
        trip["robot_late_ms"] = round(1e3 * self._robot_late_s, 1)
        if trip["health"] == "disconnected":  # the robot's silence is no reason for any other trip
            trip["false"] &= self._robot_late_s < ROBOT_LATE_S
        if trip["false"]:
            trip["windows"] = self._last_windows(status["at_s"])
        self._trips.append(trip)
        word = "FALSE" if trip["false"] else "excused"
        print(
            f"after {trip['after_min']:.1f} min, {word}: {trip['health']}: {trip['reason']}; "
            f"longest stall {trip['longest_stall_ms']} ms, limit {trip['limit_ms']:.0f} ms",
            flush=True,
        )
        self._write()

    def _last_windows(self, told_s: float) -> list[dict[str, float]]:
        """Return the windows before a trip: how long before, how late, CPU time of the loop, ms."""
        if not self._note_file.is_file():
            return []
        windows = np.array(json.loads(self._note_file.read_text(encoding="utf-8")))
        cpu_s = np.diff(windows[:, 2], prepend=windows[0, 2])
        columns = {"before_ms": told_s - windows[:, 0], "late_ms": windows[:, 1], "cpu_ms": cpu_s}
        rows = zip(
            *(np.round(1e3 * column, 2).tolist() for column in columns.values()), strict=True
        )
        return [dict(zip(columns, row, strict=True)) for row in rows]

    def _write(self) -> None:
        self._written_s = time.monotonic()
        stalls_ms = [
            1e3 * stall.length_s for stall in self._notes.between(self._begun_s, self._written_s)
        ]
        names = ("precedes", "windows", "decision_p50_us", "decision_p99_us")
        record = {
            "watched_min": round(self._watched_s / 60.0, 2),
            "false_trips": sum(trip["false"] for trip in self._trips),
            "excused_trips": sum(not trip["false"] for trip in self._trips),
            "load_median": float(np.median(self._loads)),
            "load_max": max(self._loads),
            "cores": os.cpu_count(),
            "stalls": {
                f"over_{least_ms}_ms": sum(length_ms > least_ms for length_ms in stalls_ms)
                for least_ms in (3, 5, 10, 25, 50)
            },
            "longest_stall_ms": round(max(stalls_ms, default=0.0), 1),
            "last_guard": {name: self._last.get(name) for name in names},
            "trips": self._trips,
        }
        write_json(self._output, record)


def main() -> int:
    """Guard, and say how often it tripped."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("quiet.json"))
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--burners", type=int, default=2)
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # meters end, too
    with burners(args.burners), stall_notes() as notes, tempfile.TemporaryDirectory() as folder:
        exempt_from_collection()
        as_a_robot()
        false = QuietHour(args.minutes, notes, args.output, Path(folder)).run()
    print(args.output.read_text(encoding="utf-8"))
    return int(false > 0)


if __name__ == "__main__":
    sys.exit(main())
