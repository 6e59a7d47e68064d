"""The live contact path: each window goes to the detector first, and a contact stops the arm.

Not a safety function: see :mod:`spikingtac.robot.watchdog`.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from spikingtac.cameras.words import warm_up
from spikingtac.contact.detector import WINDOW_US, ContactDetector, Window
from spikingtac.contact.recording import paired_windows
from spikingtac.errors import DeviceError
from spikingtac.events.camera import Address, is_address, is_stream
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.evt.wire import ENCODINGS
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.robot.watchdog import Health, Watchdog
from spikingtac.stream.clock import US_PER_S, StreamClock
from spikingtac.stream.reader import POLL_S, EventReader
from spikingtac.types import Contact, EventPacket

LONGEST_REASON = 1_000  # Largest number of characters of a reason (JSON takes up to 12 bytes each).

# Longest silence that is filled with windows, us. The watchdog stops the arm far sooner; the empty
# windows of a leap would only delay the ones after it.
SILENCE_US = 500_000
WARM_UP_SIZE = (320, 320)  # Size of the made-up warm-up sensor, px; kernels are alike for all.

# Windows before the guard arms, and from which share of the time that they span on they came as
# they were made, and were no pile that is read off.
LEARNED_WINDOWS, LEAST_PACE = 50, 0.9
CATCH_UP_S = 10.0  # Longest time in which a stream catches up with its sensor once opened, s.


@dataclass(frozen=True, slots=True)
class Arrival:
    """A window and the time of its arrival.

    Attributes:
        packet: The events.
        received_s: When this machine had all of the window, on the clock of the loop, s.
        losses: What the source has counted so far, by kind; ``time_jump`` are leaps of its clock.
    """

    packet: EventPacket
    received_s: float
    losses: Mapping[str, int] = field(default_factory=dict)


def stream_arrivals(path: str | Path) -> Iterator[Arrival]:
    """Yield the regular windows of a camera's pipe as they become complete.

    A :class:`~spikingtac.robot.guard.ContactProcess` takes it as
    ``partial(stream_arrivals, path=...)``; the pipe is then opened in the
    process that guards. A window is complete when an event after its end has come, which the
    sensor's noise ensures. To the watchdog, a wholly silent camera is a stalled stream.

    Args:
        path: Named pipe, address of a camera, or anything that
            :func:`~spikingtac.events.open.open_events` reads.

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
    for window in windows(source, WINDOW_US, silence_limit_us=SILENCE_US):
        if window.t_end_us - window.t_start_us == WINDOW_US:  # the last one is cut by the end
            yield Arrival(window, time.monotonic(), dict(source.losses))


def catch_up(
    stream: Iterator[Arrival], backlog_s: float, heard: Callable[[], object]
) -> StreamClock:
    """Read on until a stream is at its pace; what piled up while it was opened is dropped.

    Args:
        stream: Just opened.
        backlog_s: The stream is at its pace where it lags less than half of this.
        heard: Called with every window.

    Returns:
        How sensor time maps to host time, learned from windows at the stream's own pace.

    Raises:
        DeviceError: The stream ended, or it stays behind.
    """
    last: deque[Arrival] = deque(maxlen=LEARNED_WINDOWS)
    until_s, behind_s = float("inf"), 0.0
    for arrival in stream:
        heard()
        last.append(arrival)
        spanned_s = (arrival.packet.t_end_us - last[0].packet.t_end_us) / US_PER_S
        at_pace = arrival.received_s - last[0].received_s >= LEAST_PACE * spanned_s
        if len(last) == LEARNED_WINDOWS and at_pace:
            clock = StreamClock()
            for one in last:
                clock.arrive(one.packet.t_end_us, one.received_s)
                behind_s = clock.backlog_s(one.packet.t_end_us, one.received_s)
            if behind_s < backlog_s / 2.0:
                return clock
        until_s = min(until_s, arrival.received_s + CATCH_UP_S)
        if arrival.received_s > until_s:
            raise DeviceError(
                f"the event stream stays {behind_s * 1e3:.0f} ms behind; "
                "give the machine less other work, or lower the sensor's event rate"
            )
    raise DeviceError("the event stream ended before the guard was ready")


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
        self._windows = 0
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
        is that of this decision. ``leaps`` of the sensor's clock were too small to stop the arm;
        ``losses`` are the stream's. ``stop_failure`` says why the arm is not known to rest after a
        stop.
        """
        return {
            "health": self._watchdog.health.value,
            "reason": self._watchdog.reason,
            "contact": asdict(self.contact) if self.contact else None,
            "latency": self._latency,
            "windows": self._windows,
            "leaps": self.stream_clock.small_leaps,
            "losses": dict(self._losses or {}),
            "stop_failure": failure_words(self._watchdog.stop_failure),
        }

    def _process(self, arrival: Arrival) -> None:
        """Beat the watchdog with the backlog, decide, and stop the arm at a contact."""
        end_us, received_s = arrival.packet.t_end_us, arrival.received_s
        beat(self._watchdog, self.stream_clock, end_us, received_s, self._clock_s())
        known = arrival.losses if self._losses is None else self._losses
        self._losses = arrival.losses
        if arrival.losses.get("time_jump", 0) > known.get("time_jump", 0):
            self._watchdog.time_jump("the stream reports that the sensor's clock leapt")
        self.contact = self._detector.update(arrival.packet)
        self._windows += 1
        if self.contact is not None:
            decided_s = self._clock_s()
            self._watchdog.disarm()  # nothing beats while the arm brakes
            self._stop()
            self._latency = self._split(arrival, decided_s, self._clock_s())

    def _split(
        self, arrival: Arrival, decided_s: float, stopped_s: float
    ) -> dict[str, float | None]:
        """Return the parts of the time between the events of a contact and the command to stop, us.

        ``window_us`` is the events' mean wait for the end of their window, and ``transport_us`` the
        time to its arrival beyond the fastest transport so far: the two clocks are not the same.
        ``decision_us`` holds any queue before the loop. ``stop_us`` ends as the arm's stop returns.
        """
        packet, end_us = arrival.packet, arrival.packet.t_end_us
        return {
            "window_us": float(end_us - packet.t.mean()) if len(packet) else None,
            "transport_us": self.stream_clock.lag_s(end_us, arrival.received_s) * US_PER_S,
            "decision_us": (decided_s - arrival.received_s) * US_PER_S,
            "stop_us": (stopped_s - decided_s) * US_PER_S,
        }


def failure_words(failure: Exception | None) -> str:
    """Return a failed stop in words; nothing where none failed."""
    return "" if failure is None else f"{type(failure).__name__}: {failure}"[:LONGEST_REASON]


def beat(
    watchdog: Watchdog, clock: StreamClock, end_us: int, received_s: float, now_s: float
) -> None:
    """Tell a watchdog how late data are, and that the sensor's clock leapt.

    Args:
        watchdog: What is told.
        clock: Maps the sensor's clock to the host's.
        end_us: End of the data, on the sensor's clock, us.
        received_s: When they were here, s.
        now_s: When they are used, s.
    """
    leap_s = clock.arrive(end_us, received_s)
    watchdog.beat(clock.backlog_s(end_us, now_s))
    if leap_s > 0.0:
        watchdog.time_jump(f"the sensor's clock leapt ahead by {leap_s:.1f} s")


def watched_windows(reader: EventReader, watchdog: Watchdog) -> Iterator[Window]:
    """Yield the 1 ms windows of a camera, from what waits on; each packet is a heartbeat.

    Args:
        reader: Reads the camera.
        watchdog: Receives the backlog of each packet, and leaps of the sensor's clock.

    Raises:
        DeviceError: The watchdog has tripped.
        SpikingTacError: Whatever reading the camera raised.
    """
    return paired_windows([_watched(reader, watchdog)])


def _watched(reader: EventReader, watchdog: Watchdog) -> Iterator[EventPacket]:
    clock = StreamClock()
    with suppress(EOFError):
        while True:
            found = reader.take(POLL_S)
            if found is None:
                watchdog.require_ok()
                continue
            beat(watchdog, clock, found.packet.t_end_us, found.received_s, time.monotonic())
            yield found.packet
