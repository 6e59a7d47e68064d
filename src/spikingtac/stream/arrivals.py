"""Windows of a camera with the times of their arrival, for the contact path."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from spikingtac.cameras.words import warm_up
from spikingtac.errors import DeviceError
from spikingtac.events.address import Address, is_address, is_stream
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.evt.header import ENCODINGS
from spikingtac.events.formats.file_source import FileSource, ReadOptions
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.stream.clock import StreamClock
from spikingtac.stream.guard_loop import Arrival

# Longest silence that is filled with windows, us (ours: the watchdog stops the arm far sooner,
# and the empty windows of a leap would only delay the ones after it).
SILENCE_US = 500_000

# Width and height of a sensor whose words are made up, px; kernels are alike for all sizes.
WARM_UP_SIZE = (320, 320)

# Windows before the guard arms: one of them at least arrives without delay (ours).
LEARNED_WINDOWS = 50

# Host time over sensor time of these windows from which on they are no pile that is read off.
LEAST_PACE = 0.9

# Longest time that a stream may take to catch up with its sensor after it was opened, s (ours).
CATCH_UP_S = 10.0


def stream_arrivals(path: str | Path, period_us: int = 1_000) -> Iterator[Arrival]:
    """Yield the regular windows of a camera's pipe as they become complete.

    A :class:`~spikingtac.stream.guard.ContactProcess` takes it as
    ``Factory(function=stream_arrivals, arguments={"path": ...})``; the pipe is then opened in the
    process that guards.
    A window is complete when an event after its end has come, which the sensor's noise ensures. To
    the watchdog, a camera that is wholly silent is a stalled stream.

    A camera that is unplugged is an error, and never waited for: the watchdog has to trip.

    Args:
        path: Named pipe, address of a camera, or anything that
            :func:`~spikingtac.events.open.open_events` reads.
        period_us: Length of a window, us.

    Raises:
        RecordingError: The stream cannot be read; FormatError where it is not RAW.
        DeviceError: There is no such camera; CameraLostError where it is gone.
    """
    source = _opened(path)
    for window in windows(source, period_us, silence_limit_us=SILENCE_US):
        yield Arrival((window,), time.monotonic(), dict(source.losses))


def _opened(path: str | Path) -> FileSource:
    """Open a camera or its pipe; a pipe's reader has warmed up all of its kernels."""
    if not is_stream(Path(path)):
        return open_events(path)
    address = Address.parse(str(path) if is_address(path) else f"pipe:{path}")
    if address.kind == "pipe":  # before its writer begins; which encoding it sends is not known
        for encoding in ENCODINGS:
            warm_up(encoding, WARM_UP_SIZE)
    return CameraSource(address, ReadOptions(), when_lost="raise")


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
        if len(last) == LEARNED_WINDOWS and _at_pace(last):
            behind_s = _learnt(StreamClock(), last)
            if behind_s < backlog_s / 2.0:
                _learnt(clock, last)
                return
        until_s = min(until_s, arrival.received_s + CATCH_UP_S)
        if arrival.received_s > until_s:
            raise DeviceError(
                f"the event stream stays {behind_s * 1e3:.0f} ms behind; "
                "give the machine less other work, or lower the sensor's event rate"
            )
    raise DeviceError("the event stream ended before the guard was ready")


def _at_pace(last: Sequence[Arrival]) -> bool:
    """Return whether windows came in the time that they span, not all at once from a pile."""
    spanned_s = (last[-1].end_us - last[0].end_us) * 1e-6
    return last[-1].received_s - last[0].received_s >= LEAST_PACE * spanned_s


def _learnt(clock: StreamClock, last: Iterable[Arrival]) -> float:
    """Teach a clock some arrivals and return how far the last one is behind, s."""
    behind_s = 0.0
    for arrival in last:
        clock.arrive(arrival.end_us, arrival.received_s)
        behind_s = clock.backlog_s(arrival.end_us, arrival.received_s)
    return behind_s
