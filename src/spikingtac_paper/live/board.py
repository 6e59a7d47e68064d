"""A board that sends events in datagrams, each of which holds the same number of them.

With a fixed number for each datagram, a count of dropped datagrams is a count of lost events. A
user of a shared ring takes events beside, in a process of its own, and tells what it missed.
"""

import json
import socket
import subprocess
import sys
import time
from typing import Any

import numpy as np

from spikingtac.events import Address
from spikingtac.stream import RingCamera
from spikingtac.types import US_PER_S

EVENTS = 3_600  # Events of a datagram, which takes 14 KB.
SIZE = (320, 320)
TIME_HIGH, LOW_BITS = 8, 6  # EVT2: type of a word with the upper time, and bits of the lower time.
NAP_S = 0.0005
POLL_S = 0.05
READY = "ready"  # First line of a user that has attached.

# Groups of a datagram, and the time between two of them, us: a sensor repeats its upper time.
GROUPS, GROUP_US = 24, 2


class Datagrams:
    """Datagrams of EVT2 words: groups of events, each behind the upper part of its time."""

    def __init__(self) -> None:
        rng, shape = np.random.default_rng(0), (GROUPS, EVENTS // GROUPS)
        polarity, x, y = (rng.integers(0, top, shape).astype(np.uint32) for top in (2, *SIZE))
        self._events = polarity << 28 | x << 11 | y
        self._words = np.empty((GROUPS, 1 + shape[1]), np.uint32)

    def at(self, t_us: int) -> bytes:
        """Return the datagram that ends with a time."""
        times_us = (t_us + GROUP_US * np.arange(1 - GROUPS, 1)).astype(np.uint32)
        self._words[:, 0] = TIME_HIGH << 28 | times_us >> LOW_BITS
        low = (times_us & np.uint32((1 << LOW_BITS) - 1)) << 22
        self._words[:, 1:] = self._events | low[:, None]
        return self._words.tobytes()


def send(port: int, rate_ev_s: float, seconds: float, burst_s: float, step_s: float) -> int:
    """Send events as time passes, and return how many."""
    pieces, sent, begun_s = Datagrams(), 0, time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        while (now_s := time.monotonic() - begun_s) < seconds:
            speaking_s = now_s // 1.0 * burst_s + min(now_s % 1.0, burst_s)
            while sent * EVENTS < speaking_s * rate_ev_s:
                leapt_s = step_s if now_s > seconds / 2 else 0.0
                t_us = round((10.0 + time.monotonic() - begun_s + leapt_s) * US_PER_S)
                out.sendto(pieces.at(t_us), ("127.0.0.1", port))
                sent += 1
            time.sleep(NAP_S)
    return sent * EVENTS


class Beside:
    """A function of this module in a process of its own.

    Args:
        call: The call, as source text; it returns what JSON can hold.
    """

    def __init__(self, call: str) -> None:
        code = f"import json, sys; from {__name__} import *; sys.stdout.write(json.dumps({call}))"
        self.process = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True
        )

    def result(self) -> Any:
        """Wait for its end, and return what it returned."""
        out, _ = self.process.communicate()
        return json.loads(out)


def board(
    port: int, rate_ev_s: float, seconds: float, *, burst_s: float = 1.0, step_s: float = 0.0
) -> Beside:
    """Return a board that sends events now; its result is how many.

    Args:
        port: Where to send.
        rate_ev_s: Events per second, of the stretches in which it sends.
        seconds: For how long.
        burst_s: Stretch of every second in which it sends, s.
        step_s: By how much its clock leaps in the middle, s.
    """
    return Beside(f"send{(port, rate_ev_s, seconds, burst_s, step_s)}")


def user(name: str) -> Beside:
    """Return a user of a shared ring that has attached; its result is that of :func:`use`."""
    found = Beside(f"use({name!r})")
    assert found.process.stdout is not None
    if found.process.stdout.readline().strip() != READY:
        raise RuntimeError(f"nothing is shared under {name!r}")
    return found


def use(name: str) -> dict[str, int]:
    """Take events until their writer ends; return ``taken``, ``missed`` and ``published``."""
    camera = RingCamera.open(Address.parse(f"ring:{name}"))
    sys.stdout.write(f"{READY}\n")
    sys.stdout.flush()
    taken, published = 0, 0
    while (rows := camera.read(POLL_S)) is not None:
        taken += len(rows[3])
        published = camera.published
    return {"taken": taken, "missed": camera.losses["missed"], "published": published}


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
