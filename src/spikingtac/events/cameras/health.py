"""How a camera delivers: rate, interval between deliveries, silence, reconnects."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

RECENT_S = 2.0  # Time over which the rate is averaged, s.
LATEST = 1 << 15  # Deliveries whose intervals are reported: the latest 30 s at 1 kHz.


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
        figures = asdict(self)
        return {
            key: round(value, 3) if isinstance(value, float) else value
            for key, value in figures.items()
        }

    @property
    def sentence(self) -> str:
        """What the interval means for latency, in plain words."""
        if self.interval_p50_ms is None:
            return "nothing was delivered yet"
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
        self.connected = True
        self.events = self.deliveries = self.reconnects = 0
        self.away_s = 0.0
        self._clock_s = clock_s
        self._opened_s = clock_s()
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
