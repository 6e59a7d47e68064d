"""Play data at the speed at which they were recorded, and know how late they are."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from spikingtac.types import EventPacket

US_PER_S = 1_000_000
KEPT = 65_536
"""Frames whose lateness is kept: the last minute at 1 kHz (ours)."""


class Pace:
    """Plays data at the speed at which they were recorded, and knows how far behind it is.

    Args:
        clock_s: A clock that never goes back, s.
        sleep: Waits, s.
    """

    def __init__(
        self,
        clock_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._clock_s, self._sleep = clock_s, sleep
        self._begun: tuple[int, float] | None = None
        self._late_us = np.zeros(KEPT, np.float32)
        self._told = 0
        self.largest_lag_s = 0.0

    def wait(self, t_us: int) -> None:
        """Return when data of this time are due, at once where they are late."""
        if self._begun is None:
            self._begun = (t_us, self._clock_s())
        first_us, begun_s = self._begun
        early_s = begun_s + (t_us - first_us) / US_PER_S - self._clock_s()
        if early_s > 0.0:
            self._sleep(early_s)
        self.largest_lag_s = max(self.largest_lag_s, -early_s)

    def sent(self, t_us: int) -> None:
        """Take note that the frame of this time has left."""
        if self._begun is not None:
            first_us, begun_s = self._begun
            late_s = self._clock_s() - begun_s - (t_us - first_us) / US_PER_S
            self._late_us[self._told % KEPT] = late_s * US_PER_S
            self._told += 1

    def lateness_ms(self) -> dict[str, float]:
        """Return how late the last frames left, ms: ``p50``, ``p99`` and ``max``; may be empty."""
        told = self._late_us[: min(self._told, KEPT)] / 1e3
        if not len(told):
            return {}
        p50, p99 = np.percentile(told, (50, 99))
        figures = {"p50": p50, "p99": p99, "max": told.max()}
        return {name: round(float(value), 3) for name, value in figures.items()}


def paced(packets: Iterator[EventPacket], pace: Pace) -> Iterator[EventPacket]:
    """Yield packets at the times at which they were complete."""
    for packet in packets:
        pace.wait(packet.t_end_us)
        yield packet
