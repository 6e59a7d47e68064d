"""A board that sends events in datagrams, each of which holds the same number of them.

    python -m spikingtac_paper.live.board PORT EVENTS_PER_S SECONDS [BURST_MS PERIOD_MS [STEP_S]]

With a burst, it sends at that rate for BURST_MS of every PERIOD_MS. Its clock leaps by STEP_S in
the middle. It prints how many events it has sent: with a fixed number for each datagram, a count of
dropped datagrams is a count of lost events.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time

import numpy as np

EVENTS = 3_600  # Events of a datagram, which takes 14 KB.
SIZE = (320, 320)
TIME_HIGH, LOW_BITS = 8, 6  # EVT2: type of a word with the upper time, and bits of the lower time.
US_PER_S = 1e6
NAP_S = 0.0005

# Groups of a datagram, and the time between two of them, us: a sensor repeats its upper time.
GROUPS, GROUP_US = 24, 2


class Datagrams:
    """Datagrams of EVT2 words: groups of events, each behind the upper part of its time."""

    def __init__(self, seed: int = 0) -> None:
        rng, shape = np.random.default_rng(seed), (GROUPS, EVENTS // GROUPS)
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


def send(
    port: int, rate_ev_s: float, seconds: float, burst_s: float, period_s: float, step_s: float
) -> int:
    """Send events as time passes, and return how many."""
    pieces, sent, begun_s = Datagrams(), 0, time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        while (now_s := time.monotonic() - begun_s) < seconds:
            periods, within_s = divmod(now_s, period_s)
            speaking_s = periods * burst_s + min(within_s, burst_s)
            while sent * EVENTS < speaking_s * rate_ev_s:
                leapt_s = step_s if now_s > seconds / 2 else 0.0
                t_us = round((10.0 + time.monotonic() - begun_s + leapt_s) * US_PER_S)
                out.sendto(pieces.at(t_us), ("127.0.0.1", port))
                sent += 1
            time.sleep(NAP_S)
    return sent * EVENTS


class Board:
    """The board in a process of its own.

    Args:
        port: Where to send.
        rate_ev_s: Events per second, of the stretches in which it sends.
        seconds: For how long.
        burst_s: Stretch of every period in which it sends, s.
        period_s: Length of a period, s.
        step_s: By how much its clock leaps in the middle, s.
    """

    def __init__(
        self,
        port: int,
        rate_ev_s: float,
        seconds: float,
        *,
        burst_s: float = 1.0,
        period_s: float = 1.0,
        step_s: float = 0.0,
    ) -> None:
        given = (port, rate_ev_s, seconds, burst_s * 1e3, period_s * 1e3, step_s)
        words = [sys.executable, "-m", __name__, *map(str, given)]
        self._process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)

    def sent(self) -> int:
        """Wait for its end, and return how many events it has sent."""
        out, _ = self._process.communicate()
        return int(out)


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


if __name__ == "__main__":
    port, rate, seconds, burst_ms, period_ms, step_s = (float(word) for word in sys.argv[1:])
    sys.stdout.write(str(send(int(port), rate, seconds, burst_ms / 1e3, period_ms / 1e3, step_s)))
