"""A sensor's clock on the host's: offset and drift with their error, from when its events came.

Sensor and host share no clock, and every delivery takes some time on its way, never less than the
fastest transport. So the least differences between arrival and sensor time follow a line: its slope
is the drift between the two clocks, and its height the offset plus the fastest transport, which no
one-way stream can tell apart. The error states how well the line is known, not that constant.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

US_PER_S = 1e6
BIN_S = 0.1
"""Stretch of which the fastest arrival counts, s (ours: at 1 kHz one in a hundred is undelayed)."""
MOST_BINS = 4096
"""Stretches that are kept: then neighbours are joined, so that memory stays bounded."""
LEAST_SPAN_S = 2.0
"""Span from which on a drift is fitted, s; below, jitter of 0.1 ms would pass for 50 ppm."""
ROUNDS = 4
"""Times that late arrivals are left out: half of those above the line each time."""


_Bins = tuple[list[int], list[float], list[float]]
"""Number of each stretch, sensor time of its fastest arrival, and how late that was, s."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ClockMapping:
    """Host time = offset + sensor time x (1 + drift), both in s from the host's monotonic clock.

    Attributes:
        offset_s: Host time, on its monotonic clock, of sensor time zero, s; it holds the fastest
            transport.
        drift_ppm: How much faster the host's clock runs than the sensor's, parts per million.
        offset_error_us: Standard error of a mapped time in the middle of the span, us.
        drift_error_ppm: Standard error of the drift; None where the span is too short to fit one.
        jitter_us: Root mean square of the fastest arrivals about the line, us.
        span_s: Stretch of sensor time that the mapping is learned from, s.
        middle_us: Sensor time in the middle of what it is learned from, us.
    """

    offset_s: float
    drift_ppm: float
    offset_error_us: float
    drift_error_ppm: float | None
    jitter_us: float
    span_s: float
    middle_us: float = 0.0

    def host_s(self, t_us: int | float) -> float:
        """Return the host's monotonic time of a sensor time, s."""
        return self.offset_s + t_us / US_PER_S * (1.0 + self.drift_ppm / 1e6)

    def sensor_us(self, host_s: float) -> float:
        """Return the sensor time of a time on the host's monotonic clock, us."""
        return (host_s - self.offset_s) / (1.0 + self.drift_ppm / 1e6) * US_PER_S

    def summary(self) -> dict[str, Any]:
        """Return the figures for a manifest."""
        return asdict(self)


class ClockFit:
    """Learns a :class:`ClockMapping` while deliveries come, at constant memory."""

    def __init__(self) -> None:
        self._bin_s = BIN_S
        self._zero_s: float | None = None
        # In one piece, so that another thread may ask for the mapping meanwhile.
        self._bins: _Bins = ([], [], [])

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
        delay_s = host_s - sensor_s
        _keep_fastest(self._bins, number, sensor_s, delay_s)
        if len(self._bins[0]) >= MOST_BINS:
            self._join()

    def forget(self) -> None:
        """Begin anew: the sensor's clock was set."""
        self.__init__()

    def mapping(self) -> ClockMapping | None:
        """Return what is known; None before the first delivery."""
        numbers, sensors, delays = self._bins
        count = min(len(numbers), len(sensors), len(delays))
        if not count:
            return None
        sensor_s, delay_s = np.array(sensors[:count]), np.array(delays[:count])
        span_s = float(sensor_s[-1] - sensor_s[0])
        if span_s < LEAST_SPAN_S:
            spread_us = float(delay_s.std()) * US_PER_S
            return ClockMapping(
                offset_s=float(delay_s.min()),
                drift_ppm=0.0,
                offset_error_us=spread_us,
                drift_error_ppm=None,
                jitter_us=spread_us,
                span_s=span_s,
                middle_us=float(sensor_s.mean()) * US_PER_S,
            )
        return _fitted(sensor_s, delay_s, span_s)

    def _join(self) -> None:
        """Keep the faster one of two neighbouring stretches."""
        self._bin_s *= 2.0
        joined: _Bins = ([], [], [])
        for number, sensor_s, delay_s in zip(*self._bins, strict=True):
            _keep_fastest(joined, number // 2, sensor_s, delay_s)
        self._bins = joined


def _keep_fastest(bins: _Bins, number: int, sensor_s: float, delay_s: float) -> None:
    """Add an arrival to its stretch, of which only the fastest one is kept."""
    numbers, sensors, delays = bins
    if numbers and numbers[-1] == number:
        if delay_s < delays[-1]:
            sensors[-1], delays[-1] = sensor_s, delay_s
        return
    numbers.append(number)
    sensors.append(sensor_s)
    delays.append(delay_s)


def _fitted(
    sensor_s: NDArray[np.float64], delay_s: NDArray[np.float64], span_s: float
) -> ClockMapping:
    """Fit a line to the fastest arrivals: the late half of those above it is left out each time."""
    middle_s, base_s = float(sensor_s.mean()), float(delay_s[0])
    x, y = sensor_s - middle_s, delay_s - base_s
    keep = np.ones(len(x), bool)
    slope, height = np.polyfit(x, y, 1)
    for _ in range(ROUNDS):
        above = y - (slope * x + height)
        late = above > np.median(above[keep])
        fewer = keep & ~late
        if np.count_nonzero(fewer) < 8:
            break
        keep = fewer
        slope, height = np.polyfit(x[keep], y[keep], 1)
    rest = y[keep] - (slope * x[keep] + height)
    count = int(np.count_nonzero(keep))
    jitter_s = float(np.sqrt((rest**2).sum() / max(count - 2, 1)))
    spread = float(((x[keep] - x[keep].mean()) ** 2).sum())
    return ClockMapping(
        offset_s=base_s + float(height) - float(slope) * middle_s,
        drift_ppm=float(slope) * 1e6,
        offset_error_us=jitter_s / np.sqrt(count) * US_PER_S,
        drift_error_ppm=jitter_s / np.sqrt(spread) * 1e6 if spread else None,
        jitter_us=jitter_s * US_PER_S,
        span_s=span_s,
        middle_us=middle_s * US_PER_S,
    )
