"""Does the viewer's memory stay bounded while a page stalls? Resident memory over minutes.

Run: ``python benchmarks/viewer_soak.py --minutes 10``. One page reads and acknowledges; every 20 s
two more come that never do, one of which lets its socket fill up. The exit status is 1 where the
memory of any process of the viewer grows faster than the bound in the second half.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

COMMAND = Path(sys.executable).with_name("spikingtac")
PERIOD_S = 1.0
RENEWED_S = 20.0
"""How often stalled pages are joined by new ones: the server lets go of silent ones at 60 s."""
MOST_MIB_PER_MIN = 2.0
"""Bound on the slope: 20 MiB in ten minutes, a tenth of what one process holds."""


def resident_mib(pid: int) -> dict[int, float]:
    """Return the resident memory of a process and all its descendants, MiB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    own = {pid: pages * os.sysconf("SC_PAGE_SIZE") / 2**20}
    return own | {p: mib for child in children for p, mib in resident_mib(int(child)).items()}


def read_and_acknowledge(address: str, drawn: list[int]) -> None:
    """Be a good page until the server closes."""
    with suppress(ConnectionClosed), connect(address, max_size=None) as page:
        for message in page:
            if isinstance(message, bytes):
                drawn[0] += 1
                page.send('{"ack": 1}')


def stalled(address: str, max_queue: int | None) -> ClientConnection:
    """Connect a page that acknowledges nothing, and answers no ping of the server's if blocked."""
    return connect(
        address, max_size=None, max_queue=max_queue, ping_interval=None, close_timeout=0.1
    )


def soak(minutes: float, folder: str) -> dict[int, np.ndarray]:
    """Return ``(n, 2)`` of minutes and MiB for each process of the viewer."""
    process = subprocess.Popen(
        [COMMAND, "demo", "--no-browser", "--port", "0", "-o", Path(folder, "demo.png")],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    line = next(line for line in process.stderr if line.startswith("open http"))
    address = line.split()[1].replace("http", "ws") + "socket"
    rows: dict[int, list[tuple[float, float]]] = {}
    drawn = [0]
    with ExitStack() as pages:
        threading.Thread(target=read_and_acknowledge, args=(address, drawn), daemon=True).start()
        begun_s = time.monotonic()
        stalled_at_s = -RENEWED_S
        while (since_min := (time.monotonic() - begun_s) / 60) < minutes:
            if 60 * since_min - stalled_at_s > RENEWED_S:
                stalled_at_s = 60 * since_min
                for queue in (1, None):  # the first lets its socket fill up
                    page = pages.enter_context(stalled(address, queue))
                    page.send('{"map": true}')
            for pid, mib in resident_mib(process.pid).items():
                rows.setdefault(pid, []).append((since_min, mib))
            time.sleep(PERIOD_S)
        process.send_signal(signal.SIGINT)
    process.wait(30)
    print(f"{drawn[0]} frames went to the page that reads")
    return {pid: np.array(values) for pid, values in rows.items()}


def main() -> int:
    """Soak, print the slopes of the second half, and say whether they are in bounds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    minutes = parser.parse_args().minutes
    with tempfile.TemporaryDirectory() as folder:
        courses = soak(minutes, folder)
    worst = 0.0
    for pid, course in courses.items():
        late = course[course[:, 0] > minutes / 2]
        if len(late) < 2:
            print(f"process {pid}: ended in the first half at {course[-1, 1]:.0f} MiB")
            continue
        slope = float(np.polyfit(late[:, 0], late[:, 1], 1)[0])
        worst = max(worst, slope)
        print(f"process {pid}: {late[-1, 1]:.0f} MiB, {slope:+.2f} MiB/min in the second half")
    return int(worst > MOST_MIB_PER_MIN)


if __name__ == "__main__":
    sys.exit(main())
