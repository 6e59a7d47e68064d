"""Whether the skin rests now, judged by the rate of events so far."""

from __future__ import annotations

from collections import deque

import numpy as np

from spikingtac.markers.calibration.finding.rest import RestConfig
from spikingtac.types import EventPacket

MOST_BINS = 1_200
"""Bins that are remembered: a minute of 50 ms each."""

NOISE_DEVIATIONS = 5.0
"""Quiet counts reach from 1.6 standard deviations of Poisson noise below their mean (the fifth
percentile) to some three above it."""


class RestWatch:
    """Counts events in bins and separates rest from motion, as the calibration does afterwards.

    Attributes:
        rests: Rests so far, the present one included.
        resting: Whether the skin rests now.
    """

    def __init__(self, config: RestConfig | None = None) -> None:
        self._config = config or RestConfig()
        self._bin_us = self._config.bin_us * self._config.smooth_bins
        self._bins: deque[int] = deque(maxlen=MOST_BINS)
        self._begin_us: int | None = None
        self._count = 0
        self._quiet_us = 0
        self.rests = 0

    @property
    def resting(self) -> bool:
        """Whether the quiet has lasted for as long as a rest does."""
        return self._quiet_us >= self._config.shortest_us

    def absorb(self, packet: EventPacket) -> None:
        """Take the next events."""
        if self._begin_us is None:
            self._begin_us = packet.t_start_us
        first = 0
        while packet.t_end_us >= self._begin_us + self._bin_us:
            last = int(np.searchsorted(packet.t, self._begin_us + self._bin_us))
            self._end_bin(self._count + last - first)
            first, self._count = last, 0
            self._begin_us += self._bin_us
            self._begin_us += self._silent_us(packet, first)
        self._count += len(packet) - first

    def _silent_us(self, packet: EventPacket, first: int) -> int:
        # A long silence is one rest; its bins are not counted one by one.
        assert self._begin_us is not None
        next_us = int(packet.t[first]) if first < len(packet) else packet.t_end_us
        skipped = (next_us - self._begin_us) // self._bin_us
        if skipped < MOST_BINS:
            return 0
        self._bins.extend([0] * MOST_BINS)
        return int(skipped) * self._bin_us

    def _end_bin(self, count: int) -> None:
        self._bins.append(count)
        was = self.resting
        self._quiet_us = self._quiet_us + self._bin_us if count <= self._limit() else 0
        self.rests += self.resting and not was

    def _limit(self) -> float:
        # As in finding.rest.find_rests, over what came so far; that may be noise alone.
        counts = np.array(self._bins, float)
        floor = float(np.percentile(counts, self._config.quiet_percentile))
        busiest = np.sort(counts)[::-1]
        busy = float(busiest[np.searchsorted(np.cumsum(busiest), 0.5 * busiest.sum())])
        scatter = NOISE_DEVIATIONS * floor**0.5 + NOISE_DEVIATIONS
        return floor + max(self._config.quiet_share * (busy - floor), scatter)
