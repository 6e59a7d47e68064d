"""The live contact path: each window goes to the detector first, and a contact stops the arm.

Not a safety function: see :mod:`spikingtac.robot.watchdog`.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from spikingtac.cameras.words import warm_up
from spikingtac.contact.detector import ContactDetector, Window, packets_of
from spikingtac.errors import DeviceError
from spikingtac.events.address import Address, is_address, is_stream
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.evt.wire import ENCODINGS
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.robot.watchdog import Health, Watchdog
from spikingtac.stream.clock import StreamClock
from spikingtac.types import Contact

# Longest silence that is filled with windows, us. The watchdog stops the arm far sooner; the empty
# windows of a leap would only delay the ones after it.
SILENCE_US = 500_000
WARM_UP_SIZE = (320, 320)  # Size of the made-up warm-up sensor, px; kernels are alike for all.

# Windows before the guard arms, and from which share of the time that they span on they came as
# they were made, and were no pile that is read off.
LEARNED_WINDOWS, LEAST_PACE = 50, 0.9
CATCH_UP_S = 10.0  # Longest time in which a stream catches up with its sensor once opened, s.

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


def stream_arrivals(path: str | Path, period_us: int = 1_000) -> Iterator[Arrival]:
    """Yield the regular windows of a camera's pipe as they become complete.

    A :class:`~spikingtac.stream.guard.ContactProcess` takes it as
    ``Factory(function=stream_arrivals, arguments={"path": ...})``; the pipe is then opened in the
    process that guards. A window is complete when an event after its end has come, which the
    sensor's noise ensures. To the watchdog, a wholly silent camera is a stalled stream.

    Args:
        path: Named pipe, address of a camera, or anything that
            :func:`~spikingtac.events.open.open_events` reads.
        period_us: Length of a window, us.

    Raises:
        RecordingError: The stream cannot be read; FormatError where it is not RAW.
        DeviceError: There is no such camera; CameraLostError where it is gone. It is never waited
            for, since the watchdog has to trip.
    """
    if is_stream(Path(path)):
        address = Address.parse(str(path) if is_address(path) else f"pipe:{path}")
        if address.kind == "pipe":  # before its writer begins; its encoding is not known yet
            for encoding in ENCODINGS:
                warm_up(encoding, WARM_UP_SIZE)
        source = CameraSource(address, ReadOptions(), when_lost="raise")
    else:
        source = open_events(path)
    for window in windows(source, period_us, silence_limit_us=SILENCE_US):
        yield Arrival((window,), time.monotonic(), dict(source.losses))


def catch_up(stream: Iterator[Arrival], clock: StreamClock, backlog_s: float) -> None:
    """Read on until a stream is at its pace; what piled up while it was opened is dropped.

    Args:
        stream: Just opened.
        clock: Learns how sensor time maps to host time, from windows at the stream's own pace.
        backlog_s: The stream is at its pace where it lags less than half of this.

    Raises:
        DeviceError: The stream ended, or it stays behind.
    """
    last: deque[Arrival] = deque(maxlen=LEARNED_WINDOWS)
    until_s, behind_s = float("inf"), 0.0
    for arrival in stream:
        last.append(arrival)
        spanned_s = (arrival.end_us - last[0].end_us) / US_PER_S
        at_pace = arrival.received_s - last[0].received_s >= LEAST_PACE * spanned_s
        if len(last) == LEARNED_WINDOWS and at_pace:
            trial = StreamClock()
            behind_s = [_learn(trial, one) for one in last][-1]
            if behind_s < backlog_s / 2.0:
                for one in last:
                    _learn(clock, one)
                return
        until_s = min(until_s, arrival.received_s + CATCH_UP_S)
        if arrival.received_s > until_s:
            raise DeviceError(
                f"the event stream stays {behind_s * 1e3:.0f} ms behind; "
                "give the machine less other work, or lower the sensor's event rate"
            )
    raise DeviceError("the event stream ended before the guard was ready")


def _learn(clock: StreamClock, arrival: Arrival) -> float:
    """Teach a clock an arrival, and return how far it is behind, s."""
    clock.arrive(arrival.end_us, arrival.received_s)
    return clock.backlog_s(arrival.end_us, arrival.received_s)
