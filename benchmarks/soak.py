"""Eight hours in ten minutes: does the memory of recorder, guard and viewer stay flat?

    python benchmarks/soak.py [--hours 8] [--minutes 10] [--without-viewer]

Recorder and guard work through the sensor time of the hours as fast as the minutes ask: the
recorder writes 2,000 events a second in EVT3 into a temporary file, the guard's loop takes windows
of 10 ms with the detector ``event_count`` on a clock that runs with the sensor's. The viewer serves
a good page and pages that stall, in real time (viewer_soak.py): its load, not its clock, is that of
hours. The exit code is 1 where resident memory grows in the second half by more than the bounds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from viewer_soak import MOST_MIB_PER_MIN
from viewer_soak import soak as soak_viewer

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from spikingtac.contact.registry import DetectionConfig, make_detector  # noqa: E402
from spikingtac.events import create_events  # noqa: E402
from spikingtac.live.guard.contact_loop import Arrival, ContactLoop  # noqa: E402
from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig  # noqa: E402
from spikingtac.types import EventPacket  # noqa: E402

SIZE = (320, 320)
WINDOW_US = 10_000
EVENTS_PER_WINDOW = 20
"""2,000 events a second: a sensor at rest, with its noise."""
POOL = 500
MOST_MIB_PER_HOUR = 0.5
"""Bound on the growth of recorder and guard over an hour of sensor time: 4 MiB in eight hours."""
SAMPLES = 200
WORKERS = ("recorder", "guard")


def pool() -> list[tuple[np.ndarray, ...]]:
    """Return the events of some windows, times from 0."""
    rng = np.random.default_rng(1)
    made = []
    for _ in range(POOL):
        n = int(rng.poisson(EVENTS_PER_WINDOW))
        x, y = (rng.integers(0, side, n).astype(np.uint16) for side in SIZE)
        made.append((x, y, rng.random(n) < 0.5, np.sort(rng.integers(0, WINDOW_US, n))))
    return made


def window(events: tuple[np.ndarray, ...], number: int) -> EventPacket:
    """Return a window with its times."""
    x, y, p, t = events
    start_us = number * WINDOW_US
    return EventPacket(x, y, p, t + start_us, start_us, start_us + WINDOW_US, SIZE)


def work(name: str, hours: float, minutes: float) -> int:
    """Work through the hours, evenly over the minutes; print memory as rows of hours and MiB."""
    count, events = int(hours * 3.6e9 / WINDOW_US), pool()
    rows: list[tuple[float, float]] = []
    begun_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        take, end = recorder(Path(folder)) if name == "recorder" else guard(events)
        for number in range(count):
            take(window(events[number % POOL], number))
            if number % (count // SAMPLES) == 0:
                done_h = number * WINDOW_US / 3.6e9
                rows.append((done_h, resident_mib_of_this()))
                ahead_s = 60.0 * minutes * number / count - (time.monotonic() - begun_s)
                time.sleep(max(ahead_s, 0.0))
        summary = end()
    print(json.dumps({"rows": rows, "took_s": time.monotonic() - begun_s, **summary}), flush=True)
    return 0


def resident_mib_of_this() -> float:
    """Return the resident memory of this process, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def recorder(folder: Path):
    """Return what writes a window, and what ends the file and tells its size."""
    path = folder / "events.raw"
    writer = create_events(path, SIZE)

    def end() -> dict[str, float]:
        writer.close()
        return {"file_mb": path.stat().st_size / 1e6}

    return writer.write, end


def guard(events: list[tuple[np.ndarray, ...]]):
    """Return what gives a guard's loop a window, and what tells its state."""
    now_s = [0.0]
    quiet = (((window(events[k % POOL], k)),) for k in range(6_000))
    config = DetectionConfig(false_alarms_per_hour=0.001)
    detector = make_detector("event_count", config, [], quiet)
    watchdog = Watchdog(WatchdogConfig(stale_s=1.0), lambda: None, lambda: now_s[0])
    watchdog.self_test()
    watchdog.arm()
    loop = ContactLoop(detector, watchdog, lambda: None, clock_s=lambda: now_s[0])
    contacts = [0]

    def take(packet: EventPacket) -> None:
        now_s[0] = packet.t_end_us * 1e-6
        loop._process(Arrival((packet,), now_s[0]))  # guard() would end at a contact
        if loop.contact is not None:
            contacts[0] += 1
            loop.contact = None
            detector.reset()
            watchdog.arm()

    def end() -> dict[str, float]:
        trips = float(watchdog.check() is not Health.OK)
        return {"windows": loop.report().windows, "contacts": contacts[0], "trips": trips}

    return take, end


def main() -> int:
    """Let all three work side by side; print how their memory went."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--without-viewer", action="store_true")
    parser.add_argument("--worker", choices=WORKERS)
    args = parser.parse_args()
    if args.worker:
        return work(args.worker, args.hours, args.minutes)
    spans = ["--hours", str(args.hours), "--minutes", str(args.minutes)]
    workers = {
        name: subprocess.Popen(
            [sys.executable, __file__, "--worker", name, *spans], stdout=subprocess.PIPE, text=True
        )
        for name in WORKERS
    }
    grows = 0
    if not args.without_viewer:
        with tempfile.TemporaryDirectory() as folder:
            courses = soak_viewer(args.minutes, folder)
        for pid, course in courses.items():
            late = course[course[:, 0] > args.minutes / 2]
            if len(late) > 1:
                slope = float(np.polyfit(late[:, 0], late[:, 1], 1)[0])
                grows += slope > MOST_MIB_PER_MIN
                print(f"viewer, process {pid}: {late[-1, 1]:.0f} MiB, {slope:+.3f} MiB/min")
    for name, worker in workers.items():
        text, _ = worker.communicate()
        found = json.loads(text)
        rows = np.array(found.pop("rows"))
        late = rows[rows[:, 0] > args.hours / 2]
        slope = float(np.polyfit(late[:, 0], late[:, 1], 1)[0])
        grows += slope > MOST_MIB_PER_HOUR
        print(
            f"{name}: {rows[0, 1]:.1f} MiB at first, {rows[-1, 1]:.1f} MiB at the end, "
            f"{slope:+.4f} MiB per hour in the second half; {found}"
        )
    return int(grows > 0)


if __name__ == "__main__":
    sys.exit(main())
