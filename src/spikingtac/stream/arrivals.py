"""Windows of a live stream as they arrive: for an arm's guard, and under a watchdog."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from spikingtac.cameras.words import warm_up
from spikingtac.contact.detector import WINDOW_US, Window, packets_of
from spikingtac.errors import DeviceError
from spikingtac.events.address import Address, is_address, is_stream
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.evt.wire import ENCODINGS
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.robot.watchdog import Watchdog
from spikingtac.stream.clock import StreamClock
from spikingtac.stream.reader import POLL_S, EventReader
from spikingtac.types import EventPacket

# Longest silence that is filled with windows, us. The watchdog stops the arm far sooner; the empty
# windows of a leap would only delay the ones after it.
SILENCE_US = 500_000
WARM_UP_SIZE = (320, 320)  # Size of the made-up warm-up sensor, px; kernels are alike for all.

# Windows before the guard arms, and from which share of the time that they span on they came as
# they were made, and were no pile that is read off.
LEARNED_WINDOWS, LEAST_PACE = 50, 0.9
CATCH_UP_S = 10.0  # Longest time in which a stream catches up with its sensor once opened, s.
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


def stream_arrivals(path: str | Path, period_us: int = 1_000) -> Iterator[Arrival]:
    """Yield the regular windows of a camera's pipe as they become complete.

    A :class:`~spikingtac.stream.guard.ContactProcess` takes it as
    ``partial(stream_arrivals, path=...)``; the pipe is then opened in the
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
        spanned_s = (arrival.end_us - last[0].end_us) / US_PER_S
        at_pace = arrival.received_s - last[0].received_s >= LEAST_PACE * spanned_s
        if len(last) == LEARNED_WINDOWS and at_pace:
            clock = StreamClock()
            for one in last:
                clock.arrive(one.end_us, one.received_s)
                behind_s = clock.backlog_s(one.end_us, one.received_s)
            if behind_s < backlog_s / 2.0:
                return clock
        until_s = min(until_s, arrival.received_s + CATCH_UP_S)
        if arrival.received_s > until_s:
            raise DeviceError(
                f"the event stream stays {behind_s * 1e3:.0f} ms behind; "
                "give the machine less other work, or lower the sensor's event rate"
            )
    raise DeviceError("the event stream ended before the guard was ready")


def watched_windows(reader: EventReader, watchdog: Watchdog) -> Iterator[Window]:
    """Yield the 1 ms windows of a camera, from what waits on; each packet is a heartbeat.

    Args:
        reader: Reads the camera.
        watchdog: Receives the backlog of each packet, and leaps of the sensor's clock.

    Raises:
        DeviceError: The watchdog has tripped.
        SpikingTacError: Whatever reading the camera raised.
    """
    for window in windows(_watched(reader, watchdog), WINDOW_US):
        if window.t_end_us - window.t_start_us == WINDOW_US:
            yield (window,)


def _watched(reader: EventReader, watchdog: Watchdog) -> Iterator[EventPacket]:
    clock = StreamClock()
    with suppress(EOFError):
        while True:
            found = reader.take(POLL_S)
            if found is None:
                watchdog.require_ok()
                continue
            end_us = found.packet.t_end_us
            leap_s = clock.arrive(end_us, found.received_s)
            watchdog.beat(clock.backlog_s(end_us, time.monotonic()))
            if leap_s > 0.0:
                watchdog.time_jump(f"the sensor's clock leapt ahead by {leap_s:.1f} s")
            yield found.packet
