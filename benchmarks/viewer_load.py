"""Do pages slow tracking? The demo alone beside the demo with pages that crowd, stall or misbehave.

Run: ``python benchmarks/viewer_load.py --rounds 5``. Each round measures every case between two
stretches without it, so that what else the machine does meets both alike. One page reads all the
time and takes the session's own figures: estimates per second of wall clock and the median time of
a step. The exit status is 1 where a case makes the median round slower than the bound.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from spikingtac.viewer.session.wire import decode

COMMAND = Path(sys.executable).with_name("spikingtac")
MEASURED_S, SETTLING_S = 3.0, 0.7
CROWD = 20
MOST_SLOWER = 0.05
"""Bound on the share by which a case may slow tracking."""
REFUSED_PER_S = 50
"""Attempts a second of a page that is refused each time; a script that retries is slower."""


def crowd_that_reads(address: str, ready: Event, ended: Event) -> None:
    """Twenty pages that acknowledge every frame."""
    with ExitStack() as stack:
        pages = [stack.enter_context(page(address)) for _ in range(CROWD)]
        ready.set()
        while not ended.is_set():
            for each in pages:
                with suppress(TimeoutError):
                    if isinstance(each.recv(0.001), bytes):
                        each.send('{"ack": 1}')


def crowd_that_stalls(address: str, ready: Event, ended: Event) -> None:
    """Twenty pages that acknowledge nothing; half of them let their sockets fill up."""
    with ExitStack() as stack:
        for number in range(CROWD):
            stack.enter_context(page(address, 1 if number % 2 else None))
        ready.set()
        ended.wait()


def garbage(address: str, ready: Event, ended: Event) -> None:
    """One client that connects and sends what is no command, again and again."""
    while not ended.wait(1 / REFUSED_PER_S):
        with suppress(ConnectionClosed, InvalidStatus), page(address) as bad:
            bad.send("}{" * 100)
            ready.set()
            while True:
                bad.recv(1.0)


def foreign(address: str, ready: Event, ended: Event) -> None:
    """A page of another origin and a rebound name, refused again and again."""
    http = address.replace("ws", "http").removesuffix("socket")
    while not ended.wait(1 / REFUSED_PER_S):
        with suppress(InvalidStatus), connect(address, origin="http://evil.example"):  # type: ignore[arg-type]
            raise RuntimeError("a foreign origin was let in")
        if httpx.get(http, headers={"host": "evil.example"}).status_code != 403:
            raise RuntimeError("a foreign host was let in")
        ready.set()


CASES: dict[str, Callable[[str, Event, Event], None]] = {
    "20 pages that read": crowd_that_reads,
    "20 pages that stall": crowd_that_stalls,
    "garbage": garbage,
    "foreign origin and host": foreign,
}


def page(address: str, max_queue: int | None = None) -> ClientConnection:
    """Connect as a page does."""
    return connect(
        address, max_size=None, max_queue=max_queue, ping_interval=None, close_timeout=0.1
    )


@dataclass(frozen=True)
class Figures:
    """What the session says of a stretch.

    Attributes:
        estimates_per_s: Estimates per second of wall clock.
        step_us: Median time of a step, us.
    """

    estimates_per_s: float
    step_us: float


def watched(watcher: ClientConnection) -> Figures:
    """Read along for a while."""
    first = last = frame(watcher)
    while last["stamp_ms"] - first["stamp_ms"] < 1e3 * MEASURED_S:
        last = frame(watcher)
    lasted_s = (last["stamp_ms"] - first["stamp_ms"]) / 1e3
    return Figures((last["steps"] - first["steps"]) / lasted_s, last["step_p50_us"])


def frame(watcher: ClientConnection) -> dict[str, Any]:
    """Return the scalars of the next frame."""
    while True:
        message = watcher.recv(60.0)
        if isinstance(message, bytes):
            watcher.send('{"ack": 1}')
            return decode(message)[0]


def settle(watcher: ClientConnection) -> None:
    """Read along until what has just changed no longer shows."""
    until_s = time.monotonic() + SETTLING_S
    while time.monotonic() < until_s:
        frame(watcher)


def beside(watcher: ClientConnection, address: str, case: str) -> Figures:
    """Return the figures beside a case, which runs in a process of its own."""
    context = multiprocessing.get_context("spawn")
    ready, ended = context.Event(), context.Event()
    process = context.Process(target=CASES[case], args=(address, ready, ended))
    process.start()
    try:
        while process.is_alive() and not ready.is_set():
            settle(watcher)
        settle(watcher)
        if not process.is_alive():
            raise RuntimeError(f"the clients of {case!r} ended by themselves")
        return watched(watcher)
    finally:
        ended.set()
        while process.is_alive():
            settle(watcher)
        settle(watcher)


def measure(address: str, rounds: int) -> dict[str, list[tuple[Figures, Figures]]]:
    """Return ``(alone, beside)`` of each case and round; alone is the mean of before and after."""
    pairs: dict[str, list[tuple[Figures, Figures]]] = {case: [] for case in CASES}
    with page(address) as watcher:
        while "steps" not in frame(watcher):
            continue
        settle(watcher)
        for _ in range(rounds):
            before = watched(watcher)
            for case, found in pairs.items():
                loaded = beside(watcher, address, case)
                after = watched(watcher)
                found.append((mean(before, after), loaded))
                before = after
    return pairs


def mean(one: Figures, other: Figures) -> Figures:
    """Return the mean of two stretches."""
    rate = (one.estimates_per_s + other.estimates_per_s) / 2
    return Figures(rate, (one.step_us + other.step_us) / 2)


def summarise(pairs: list[tuple[Figures, Figures]]) -> dict[str, float]:
    """Return the medians of a case over its rounds."""
    slower = [1 - loaded.estimates_per_s / alone.estimates_per_s for alone, loaded in pairs]
    longer = [loaded.step_us / alone.step_us - 1 for alone, loaded in pairs]
    return {
        "alone_per_s": float(np.median([alone.estimates_per_s for alone, _ in pairs])),
        "beside_per_s": float(np.median([loaded.estimates_per_s for _, loaded in pairs])),
        "slower": float(np.median(slower)),
        "step_longer": float(np.median(longer)),
    }


def main() -> int:
    """Start the demo, measure, print; 1 where tracking is slowed beyond the bound."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(
            [COMMAND, "demo", "--no-browser", "--port", "0", "-o", Path(folder, "demo.png")],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stderr is not None
        try:
            line = next(line for line in process.stderr if line.startswith("open http"))
            pairs = measure(line.split()[1].replace("http", "ws") + "socket", rounds)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    found = {case: summarise(rounds_of) for case, rounds_of in pairs.items()}
    print(json.dumps({"cores": cores, "load": load, "rounds": rounds, "cases": found}, indent=1))
    return int(max(figures["slower"] for figures in found.values()) > MOST_SLOWER)


if __name__ == "__main__":
    sys.exit(main())
