"""The live contact path: each window goes to the detector first, and a contact stops the arm.

Not a safety function: see :mod:`spikingtac.robot.watchdog`.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.window import Window, packets_of
from spikingtac.robot.watchdog import Health, Watchdog
from spikingtac.stream.clock import StreamClock
from spikingtac.types import Contact

RECENT_WINDOWS = 4096  # Decision times kept for the percentiles: 4 s at 1 kHz.
US_PER_S = 1e6


@dataclass(frozen=True, slots=True)
class Arrival:
    """A window and the time of its arrival.

    Attributes:
        window: The events.
        received_s: When this machine had all of the window, on the clock of the loop, s.
        losses: What the source has counted so far, by kind; ``time_jump`` are leaps of its clock.
    """

    window: Window
    received_s: float
    losses: Mapping[str, int] = field(default_factory=dict)

    @property
    def end_us(self) -> int:
        """End of the window, on the sensor's clock, us."""
        return packets_of(self.window)[0].t_end_us


@dataclass(frozen=True, slots=True)
class Latency:
    """Parts of the time between the events of a contact and the command to stop.

    Attributes:
        window_us: The events' mean wait for the end of their window, us; None without events.
        transport_us: From the end of the window to its arrival, us, beyond the fastest transport
            so far: sensor and host share no clock.
        decision_us: From the arrival to the decision, us, with any queue before the loop.
        stop_us: From the decision to the return of the arm's stop, us.
    """

    window_us: float | None
    transport_us: float
    decision_us: float
    stop_us: float


@dataclass(frozen=True, slots=True)
class GuardReport:
    """State of a guard, now or at its end.

    Attributes:
        health: Of the watchdog.
        reason: What tripped it; empty while OK.
        contact: What stopped the arm, or None.
        latency: Of that decision.
        windows: How many windows were processed.
        backlog_s: How far the processed data lag behind the fastest transport, s.
        decision_p50_us: Median time to decide over the recent windows, us.
        decision_p99_us: 99th percentile of the same, us.
        leaps: Leaps of the sensor's clock that were too small to stop the arm.
        losses: What the stream lost or had to mend, by kind.
        stop_failure: Why the arm is not known to rest after a stop; empty where it rests, or where
            nothing has stopped it.
    """

    health: Health
    reason: str
    contact: Contact | None
    latency: Latency | None
    windows: int
    backlog_s: float
    decision_p50_us: float
    decision_p99_us: float
    leaps: int
    losses: dict[str, int]
    stop_failure: str


class ContactLoop:
    """Decides on each window before anything else is done with it.

    Args:
        detector: Decides on contact.
        watchdog: Armed by the caller; it stops the same arm. Each window is a heartbeat.
        stop: Stops the arm.
        clock_s: The clock of the arrivals and of the watchdog.
        stream_clock: Knows the stream's earlier windows; None begins with the first one.

    Attributes:
        contact: What stopped the arm, or None so far.
    """

    def __init__(
        self,
        detector: ContactDetector,
        watchdog: Watchdog,
        stop: Callable[[], None],
        clock_s: Callable[[], float] = time.monotonic,
        stream_clock: StreamClock | None = None,
    ) -> None:
        self._detector, self._watchdog, self._stop = detector, watchdog, stop
        self._stream_clock = stream_clock or StreamClock()
        self._losses: Mapping[str, int] | None = None
        self._backlog_s = 0.0
        self._clock_s = clock_s
        self._recent_us: deque[float] = deque(maxlen=RECENT_WINDOWS)
        self._windows = 0
        self.contact: Contact | None = None
        self._latency: Latency | None = None

    def guard(
        self,
        arrivals: Iterable[Arrival],
        after_window: Callable[[ContactLoop], object] = lambda _: None,
    ) -> GuardReport:
        """Watch a stream until a contact, a trip of the watchdog, or its end, which is a trip.

        Args:
            arrivals: Windows as they come; waiting for one lets the watchdog's thread work.
            after_window: Called after each window; it must not block.
        """
        for arrival in arrivals:
            self._process(arrival)
            after_window(self)
            if self.contact is not None or self._watchdog.check() is not Health.OK:
                return self.report()
        self._watchdog.disconnected("the event stream ended")
        return self.report()

    def report(self) -> GuardReport:
        """Return the state now."""
        p50_us, p99_us = np.percentile(np.array(self._recent_us or (0.0,)), (50, 99)).tolist()
        return GuardReport(
            health=self._watchdog.health,
            reason=self._watchdog.reason,
            contact=self.contact,
            latency=self._latency,
            windows=self._windows,
            backlog_s=self._backlog_s,
            decision_p50_us=p50_us,
            decision_p99_us=p99_us,
            leaps=self._stream_clock.small_leaps,
            losses=dict(self._losses or {}),
            stop_failure=failure_words(self._watchdog.stop_failure),
        )

    def _process(self, arrival: Arrival) -> None:
        begun_s = self._clock_s()
        self._compare_clocks(arrival, begun_s)
        contact = self._detector.update(arrival.window)
        decided_s = self._clock_s()
        if contact is not None:
            self._watchdog.disarm()  # nothing beats while the arm brakes
            self._stop()
            self.contact = contact
            stopped_s = self._clock_s()
            self._latency = self._split(arrival, decided_s, stopped_s)
        self._recent_us.append((decided_s - begun_s) * US_PER_S)
        self._windows += 1

    def _compare_clocks(self, arrival: Arrival, begun_s: float) -> None:
        """Beat the watchdog with the backlog, and report a leap of the sensor's clock."""
        leap_s = self._stream_clock.arrive(arrival.end_us, arrival.received_s)
        self._backlog_s = self._stream_clock.backlog_s(arrival.end_us, begun_s)
        self._watchdog.beat(self._backlog_s)
        known, self._losses = self._losses, arrival.losses
        if leap_s > 0.0:
            self._watchdog.time_jump(f"the sensor's clock leapt ahead by {leap_s:.1f} s")
        elif known is not None and arrival.losses.get("time_jump", 0) > known.get("time_jump", 0):
            self._watchdog.time_jump("the stream reports that the sensor's clock leapt")

    def _split(self, arrival: Arrival, decided_s: float, stopped_s: float) -> Latency:
        packets = packets_of(arrival.window)
        times_us = np.concatenate([packet.t for packet in packets])
        end_us = arrival.end_us
        return Latency(
            window_us=float(end_us - times_us.mean()) if len(times_us) else None,
            transport_us=self._stream_clock.lag_s(end_us, arrival.received_s) * US_PER_S,
            decision_us=(decided_s - arrival.received_s) * US_PER_S,
            stop_us=(stopped_s - decided_s) * US_PER_S,
        )


def failure_words(failure: Exception | None) -> str:
    """Return a failed stop in words; nothing where none failed."""
    return "" if failure is None else f"{type(failure).__name__}: {failure}"
