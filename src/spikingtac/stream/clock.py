"""Sensor time against host time: how far a live stream is behind, and whether its clock leapt.

Sensor and host share no clock. The fastest transport so far maps one to the other; what arrives
later than it lags behind. The map may drift, since no two crystals run alike; a backlog that grows
more slowly than they may is taken for drift.
"""

from collections import deque

from spikingtac.events.clock import DRIFT
from spikingtac.types import US_PER_S

# A sensor time that runs ahead of host time by this much is a leap, s (filled with empty
# windows it costs a detector 20 ms; transport varies by less).
LEAP_S = 0.5

# What stays ahead by the first for as long as the second is a small leap, s, which is counted
# (transport varies by less, and the windows that fill a leap are read within it).
SMALL_LEAP_S, SETTLED_S = 0.1, 0.1

# A backlog counts once it has lasted this long, s (USB transfers deliver several windows at
# once, of which the first are late).
SPAN_S = 0.020


class StreamClock:
    """Follows one stream; both clocks may only go forward.

    Attributes:
        small_leaps: Leaps ahead that were too small to begin the map anew.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None  # host less sensor time of the fastest transport
        self._usual_s = 0.0  # the same of the usual transport; it changes with the drift only
        self._last_s = 0.0
        self._ahead_since_s: float | None = None
        self.small_leaps = 0
        self._lags: deque[tuple[float, float]] = deque()

    def arrive(self, sensor_us: int, host_s: float) -> float:
        """Learn from an arrival.

        Args:
            sensor_us: Sensor time of the arrived data's end, us.
            host_s: Host time of their arrival, s.

        Returns:
            By how much the sensor's clock leapt ahead, s; 0 without a leap. The map begins anew
            after a leap, so that each is returned once.
        """
        delay_s = host_s - sensor_us / US_PER_S
        if self._offset_s is None:
            self._begin(delay_s, host_s)
            return 0.0
        drift_s = DRIFT * max(host_s - self._last_s, 0.0)
        self._last_s = max(host_s, self._last_s)
        ahead_s = self._usual_s - drift_s - delay_s
        if ahead_s >= LEAP_S:
            self._begin(delay_s, host_s)
            return ahead_s
        self._count_small_leap(ahead_s, delay_s, host_s)
        self._offset_s = min(self._offset_s + drift_s, delay_s)
        self._usual_s += min(max(delay_s - self._usual_s, -drift_s), drift_s)
        return 0.0

    def _count_small_leap(self, ahead_s: float, delay_s: float, host_s: float) -> None:
        if ahead_s < SMALL_LEAP_S:
            self._ahead_since_s = None
        elif self._ahead_since_s is None:
            self._ahead_since_s = host_s
        elif host_s - self._ahead_since_s >= SETTLED_S:
            self.small_leaps += 1
            self._usual_s, self._ahead_since_s = delay_s, None

    def _begin(self, delay_s: float, host_s: float) -> None:
        self._offset_s = self._usual_s = delay_s
        self._ahead_since_s = None
        self._last_s = host_s
        self._lags.clear()

    def lag_s(self, sensor_us: int, host_s: float) -> float:
        """Return how much later than by the fastest transport something happens, s."""
        if self._offset_s is None:
            return 0.0
        return max(host_s - sensor_us / US_PER_S - self._offset_s, 0.0)

    def backlog_s(self, sensor_us: int, host_s: float) -> float:
        """Return the lag that has lasted for the span, s: the least lag within it.

        Args:
            sensor_us: Sensor time of the data that are processed now, us.
            host_s: Host time now, s.
        """
        self._lags.append((host_s, self.lag_s(sensor_us, host_s)))
        while len(self._lags) > 1 and self._lags[1][0] <= host_s - SPAN_S:
            self._lags.popleft()
        return min(lag_s for _, lag_s in self._lags)
