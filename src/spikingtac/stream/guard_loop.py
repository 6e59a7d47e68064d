"""The live contact path: each window goes to the detector first, and a contact stops the arm.

Not a safety function: see :mod:`spikingtac.robot.watchdog`.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from spikingtac.contact.detector import ContactDetector, packets_of
from spikingtac.robot.watchdog import Health, Watchdog
from spikingtac.stream.arrivals import US_PER_S, Arrival
from spikingtac.stream.clock import StreamClock
from spikingtac.types import Contact

LONGEST_REASON = 1_000  # Largest number of characters of a reason (JSON takes up to 12 bytes each).
RECENT_WINDOWS = 4096  # Decision times kept for the percentiles: 4 s at 1 kHz.


class ContactLoop:
    """Decides on each window before anything else is done with it.

    Args:
        detector: Decides on contact.
        watchdog: Armed by the caller; it stops the same arm. Each window is a heartbeat.
        stop: Stops the arm.
        clock_s: The clock of the arrivals and of the watchdog.

    Attributes:
        contact: What stopped the arm, or None so far.
        stream_clock: Maps the sensor's clock to the host's; one that has seen the stream's earlier
            windows may take its place.
    """

    def __init__(
        self,
        detector: ContactDetector,
        watchdog: Watchdog,
        stop: Callable[[], None],
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._detector, self._watchdog, self._stop = detector, watchdog, stop
        self.stream_clock, self._clock_s = StreamClock(), clock_s
        self._losses: Mapping[str, int] | None = None
        self._windows, self._backlog_s = 0, 0.0
        self._recent_us: deque[float] = deque(maxlen=RECENT_WINDOWS)
        self.contact: Contact | None = None
        self._latency: dict[str, float | None] | None = None

    def guard(
        self,
        arrivals: Iterable[Arrival],
        after_window: Callable[[ContactLoop], object] = lambda _: None,
    ) -> dict[str, Any]:
        """Watch a stream until a contact, a trip of the watchdog, or its end, which is a trip.

        Args:
            arrivals: Windows as they come; waiting for one lets the watchdog's thread work.
            after_window: Called after each window; it must not block.
        """
        for arrival in arrivals:
            self._process(arrival)
            after_window(self)
            if self.contact is not None or self._watchdog.check() is not Health.OK:
                break
        else:
            self._watchdog.disconnected("the event stream ended")
        return self.report()

    def report(self) -> dict[str, Any]:
        """Return the state now, as JSON can hold it.

        ``health`` and ``reason`` are the watchdog's. ``contact`` stopped the arm, and ``latency``
        is that of this decision. ``backlog_s`` is the lag of the processed data, and
        ``decision_p50_us`` and ``decision_p99_us`` are the times to decide over recent windows.
        ``leaps`` of the sensor's clock were too small to stop the arm; ``losses`` are the stream's.
        ``stop_failure`` says why the arm is not known to rest after a stop.
        """
        p50_us, p99_us = np.percentile(np.array(self._recent_us or (0.0,)), (50, 99)).tolist()
        return {
            "health": self._watchdog.health.value,
            "reason": self._watchdog.reason,
            "contact": asdict(self.contact) if self.contact else None,
            "latency": self._latency,
            "windows": self._windows,
            "backlog_s": self._backlog_s,
            "decision_p50_us": p50_us,
            "decision_p99_us": p99_us,
            "leaps": self.stream_clock.small_leaps,
            "losses": dict(self._losses or {}),
            "stop_failure": failure_words(self._watchdog.stop_failure),
        }

    def _process(self, arrival: Arrival) -> None:
        """Beat the watchdog with the backlog, decide, and stop the arm at a contact."""
        begun_s, end_us = self._clock_s(), arrival.end_us
        leap_s = self.stream_clock.arrive(end_us, arrival.received_s)
        self._backlog_s = self.stream_clock.backlog_s(end_us, begun_s)
        self._watchdog.beat(self._backlog_s)
        known = arrival.losses if self._losses is None else self._losses
        self._losses = arrival.losses
        if leap_s > 0.0:
            self._watchdog.time_jump(f"the sensor's clock leapt ahead by {leap_s:.1f} s")
        elif arrival.losses.get("time_jump", 0) > known.get("time_jump", 0):
            self._watchdog.time_jump("the stream reports that the sensor's clock leapt")
        contact = self._detector.update(arrival.window)
        decided_s = self._clock_s()
        if contact is not None:
            self._watchdog.disarm()  # nothing beats while the arm brakes
            self._stop()
            self.contact = contact
            self._latency = self._split(arrival, decided_s, self._clock_s())
        self._recent_us.append((decided_s - begun_s) * US_PER_S)
        self._windows += 1

    def _split(
        self, arrival: Arrival, decided_s: float, stopped_s: float
    ) -> dict[str, float | None]:
        """Return the parts of the time between the events of a contact and the command to stop, us.

        ``window_us`` is the events' mean wait for the end of their window, and ``transport_us`` the
        time to its arrival beyond the fastest transport so far: the two clocks are not the same.
        ``decision_us`` holds any queue before the loop. ``stop_us`` ends as the arm's stop returns.
        """
        times_us = np.concatenate([packet.t for packet in packets_of(arrival.window)])
        return {
            "window_us": float(arrival.end_us - times_us.mean()) if len(times_us) else None,
            "transport_us": self.stream_clock.lag_s(arrival.end_us, arrival.received_s) * US_PER_S,
            "decision_us": (decided_s - arrival.received_s) * US_PER_S,
            "stop_us": (stopped_s - decided_s) * US_PER_S,
        }


def failure_words(failure: Exception | None) -> str:
    """Return a failed stop in words; nothing where none failed."""
    return "" if failure is None else f"{type(failure).__name__}: {failure}"[:LONGEST_REASON]
