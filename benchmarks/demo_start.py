"""Time from ``spikingtac demo`` to arrows that move, cold (kernels to compile) and warm.

Run: ``taskset -c 0,1 python benchmarks/demo_start.py``. The kernel cache is a new empty folder, so
the first run compiles everything; the runs after it find it filled.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from spikingtac.viewer.session.wire import decode

COMMAND = Path(sys.executable).with_name("spikingtac")
MOVING_PX = 1.0
"""An arrow of so much displacement is seen to move: a tenth of what the first press reaches."""
WARM_RUNS = 2
LONGEST_S = 120.0


def start_once(cache: str, folder: str) -> dict[str, float]:
    """Start the demo and return seconds until the page is served, a frame, and moving arrows."""
    begun_s = time.monotonic()
    picture = Path(folder, "demo.png")
    process = subprocess.Popen(
        [COMMAND, "demo", "--no-browser", "--port", "0", "-o", picture, "--overwrite"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": cache},
    )
    assert process.stderr is not None
    try:
        address = next(line.split()[1] for line in process.stderr if line.startswith("open http"))
        times_s = {"page": time.monotonic() - begun_s}
        times_s |= _until_moving(address.replace("http", "ws") + "socket", begun_s)
        return times_s | {"of which CPU, busiest process": busiest_cpu_s(process.pid)}
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)


def busiest_cpu_s(pid: int) -> float:
    """Return the largest CPU time of a process and its descendants: the time on an idle machine."""
    stat = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    own_s = (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK")
    return max([own_s, *(busiest_cpu_s(int(child)) for child in children)])


def _until_moving(address: str, begun_s: float) -> dict[str, float]:
    reference_px, times_s = np.empty(0), {}
    with connect(address, max_size=None) as page:
        while time.monotonic() - begun_s < LONGEST_S:
            message = page.recv(LONGEST_S)
            if isinstance(message, str):
                reference_px = np.array(json.loads(message).get("reference_px", ()))
                continue
            page.send('{"ack": 1}')
            arrays = decode(message)[1]
            if "position_px" not in arrays:
                continue
            times_s.setdefault("first frame", time.monotonic() - begun_s)
            if np.hypot(*(arrays["position_px"] - reference_px).T).max() > MOVING_PX:
                return {**times_s, "moving arrows": time.monotonic() - begun_s}
    raise WebSocketException("no arrow moved")


if __name__ == "__main__":
    load = os.getloadavg()[0]
    print(f"{len(os.sched_getaffinity(0))} cores for the demo; load of the machine {load:.1f}")
    with tempfile.TemporaryDirectory() as cache, tempfile.TemporaryDirectory() as folder:
        for run in range(1 + WARM_RUNS):
            times_s = start_once(cache, folder)
            shown = ", ".join(f"{what} {seconds:.1f} s" for what, seconds in times_s.items())
            print(f"{'warm' if run else 'cold'}: {shown}")
