"""How a camera delivers: its clock on the host's, its rate, silence and reconnects.

Sensor and host share no clock, and every delivery takes some time on its way, never less than the
fastest transport. So the least differences between arrival and sensor time follow a line: its slope
is the drift between the two clocks, and its height the offset plus the fastest transport, which no
one-way stream can tell apart. The error states how well the line is known, not that constant.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.clock import PPM, US_PER_S, TimeMap

RECENT_S = 2.0  # Time over which the rate is averaged, s.
LATEST = 1 << 15  # Deliveries whose intervals are reported: the latest 30 s at 1 kHz.

# Stretch of which the fastest arrival counts, s (at 1 kHz one in a hundred is undelayed).
BIN_S = 0.1

# Stretches that are kept: then neighbours are joined, so that memory stays bounded.
MOST_BINS = 4096

# Span from which on a drift is fitted, s; below, jitter of 0.1 ms would pass for 50 ppm.
LEAST_SPAN_S = 2.0

# Times that late arrivals are left out, half of those above the line each time, and how many stay
# at least.
ROUNDS, LEAST_FASTEST = 4, 8

# Number of a stretch, sensor time of its fastest arrival, and how late that was, s.
_Bin = tuple[int, float, float]


class ClockFit:
    """Learns a sensor's clock on its host's while deliveries come, at constant memory."""

    def __init__(self) -> None:
        self._bin_s = BIN_S
        self._zero_s: float | None = None
        self._bins: list[_Bin] = []  # another thread may copy it meanwhile

    def arrived(self, t_us: int, host_s: float) -> None:
        """Learn from a delivery.

        Args:
            t_us: Time of its last event, us.
            host_s: When it was here, on the monotonic clock, s.
        """
        sensor_s = t_us / US_PER_S
        if self._zero_s is None:
            self._zero_s = sensor_s
        number = int((sensor_s - self._zero_s) / self._bin_s)
        _keep_fastest(self._bins, (number, sensor_s, host_s - sensor_s))
        if len(self._bins) >= MOST_BINS:
            self._bin_s *= 2.0
            joined: list[_Bin] = []
            for one, at_s, delay_s in self._bins:
                _keep_fastest(joined, (one // 2, at_s, delay_s))
            self._bins = joined

    def forget(self) -> None:
        """Begin anew: the sensor's clock was set."""
        self.__init__()

    def mapping(self) -> TimeMap | None:
        """Return what is known; None before the first delivery."""
        bins = np.array(self._bins.copy())
        if not len(bins):
            return None
        _, sensor_s, delay_s = bins.T
        middle_s, span_s = float(sensor_s.mean()), float(sensor_s[-1] - sensor_s[0])
        if span_s >= LEAST_SPAN_S:
            return _fastest_line(sensor_s - middle_s, delay_s, middle_s, span_s)
        spread_us = float(delay_s.std()) * US_PER_S
        return TimeMap(
            own_us=middle_s * US_PER_S,
            base_us=(middle_s + float(delay_s.min())) * US_PER_S,
            error_us=spread_us,
            jitter_us=spread_us,
            span_s=span_s,
        )


def _keep_fastest(bins: list[_Bin], arrival: _Bin) -> None:
    """Add an arrival to its stretch, of which only the fastest one is kept."""
    if not bins or bins[-1][0] != arrival[0]:
        bins.append(arrival)
    elif arrival[2] < bins[-1][2]:
        bins[-1] = arrival


def _fastest_line(
    x: NDArray[np.float64], delay_s: NDArray[np.float64], middle_s: float, span_s: float
) -> TimeMap:
    """Fit a line to the fastest arrivals: the late half of those above it is left out each time."""
    base_s = float(delay_s[0])
    y, keep = delay_s - base_s, np.ones(len(x), bool)
    slope, height = np.polyfit(x, y, 1)
    for _ in range(ROUNDS):
        above = y - (slope * x + height)
        fewer = keep & (above <= np.median(above[keep]))
        if np.count_nonzero(fewer) < LEAST_FASTEST:
            break
        keep = fewer
        slope, height = np.polyfit(x[keep], y[keep], 1)
    rest, count = y[keep] - (slope * x[keep] + height), int(np.count_nonzero(keep))
    jitter_s = float(np.sqrt((rest**2).sum() / max(count - 2, 1)))
    spread = float(((x[keep] - x[keep].mean()) ** 2).sum())
    return TimeMap(
        own_us=middle_s * US_PER_S,
        base_us=(middle_s + base_s + float(height)) * US_PER_S,
        drift_ppm=float(slope) / PPM,
        error_us=jitter_s / np.sqrt(count) * US_PER_S,
        drift_error_ppm=jitter_s / np.sqrt(spread) / PPM if spread else None,
        jitter_us=jitter_s * US_PER_S,
        span_s=span_s,
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraHealth:
    """State of a camera; everything is counted since it was opened unless it says recent.

    Attributes:
        connected: False while it is gone.
        events: Events delivered.
        deliveries: Times that events came.
        rate_ev_s: Recent events per second.
        interval_p50_ms: Median time between the latest deliveries, ms; None before the second one.
        interval_p99_ms: 99th percentile of the same, ms.
        silent_s: Time since the last delivery, s.
        reconnects: How often it came back.
        away_s: Time for which it was gone, s.
        losses: What was lost or mended, by kind.
    """

    connected: bool
    events: int
    deliveries: int
    rate_ev_s: float
    interval_p50_ms: float | None
    interval_p99_ms: float | None
    silent_s: float
    reconnects: int
    away_s: float
    losses: dict[str, int]

    def summary(self) -> dict[str, Any]:
        """Return the figures, rounded for a report."""
        return {
            name: round(value, 3) if isinstance(value, float) else value
            for name, value in asdict(self).items()
        }

    @property
    def sentence(self) -> str:
        """What the interval means for latency, in plain words."""
        if self.interval_p50_ms is None:
            return "one delivery so far" if self.deliveries else "nothing was delivered yet"
        text = f"packets every {self.interval_p50_ms:.1f} ms (99 %: {self.interval_p99_ms:.1f} ms)"
        if self.interval_p50_ms > 1.0:
            text += ": a 1 ms window is not a 1 ms latency"
        return text


class DeliveryMeter:
    """Counts deliveries as they come.

    Args:
        clock_s: A monotonic clock, s.
    """

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self.connected, self.away_s = True, 0.0
        self.events = self.deliveries = self.reconnects = 0
        self._clock_s, self._opened_s = clock_s, clock_s()
        self._recent: deque[tuple[float, int]] = deque(maxlen=LATEST)

    def delivered(self, events: int, now_s: float) -> None:
        """Count one delivery."""
        self.events += events
        self.deliveries += 1
        self._recent.append((now_s, events))

    def forget(self) -> None:
        """Forget when the recent deliveries came: what follows is a new stretch."""
        self._recent.clear()

    def health(self, losses: dict[str, int]) -> CameraHealth:
        """Return the state now."""
        now_s = self._clock_s()
        latest = tuple(self._recent)
        recent = [entry for entry in latest if entry[0] > now_s - RECENT_S]
        intervals = np.diff([at_s for at_s, _ in latest]) * 1e3
        p50, p99 = np.percentile(intervals, (50, 99)) if len(intervals) else (None, None)
        span_s = min(RECENT_S, max(now_s - self._opened_s, 1e-9))
        last_s = self._recent[-1][0] if self._recent else self._opened_s
        return CameraHealth(
            connected=self.connected,
            events=self.events,
            deliveries=self.deliveries,
            rate_ev_s=sum(count for _, count in recent) / span_s,
            interval_p50_ms=None if p50 is None else float(p50),
            interval_p99_ms=None if p99 is None else float(p99),
            silent_s=max(now_s - last_s, 0.0),
            reconnects=self.reconnects,
            away_s=self.away_s,
            losses=dict(losses),
        )
