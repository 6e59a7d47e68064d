"""Windows of cameras that are read as they come: of several in step, of one under a watchdog.

A camera without events does not tell what time it is. While it delivers, it is waited for. Once it
has been silent for a while by the host's clock, its part of the windows is taken as empty as far
as another sensor has come. Events that come afterwards for such a window are too late: they are
counted, and not put where they do not belong, since events of a second in one window are a contact.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress

from spikingtac.contact.detector import WINDOW_US, Window
from spikingtac.errors import DeviceError, RecordingError
from spikingtac.events.source import EventSource
from spikingtac.events.windows import SILENCE_LIMIT_US, windows
from spikingtac.robot.watchdog import Watchdog
from spikingtac.stream.clock import StreamClock
from spikingtac.stream.reader import POLL_S, EventReader
from spikingtac.types import EventPacket

# A camera that delivered nothing for so long is silent, s (the slowest of the counterparts
# delivers within 0.07 s in 99 % while a skin moves, see results/cameras/latency.md).
SILENT_S = 0.1
STARTING_S = 2.0  # The same before its first delivery, s (cameras start within one).
LOOK_S = 0.001  # Time between two looks whether a window is complete, s.
NEVER_US = -(1 << 62)


class _Sensor:
    """What was read of one sensor and is not in a window yet."""

    def __init__(self, source: EventSource) -> None:
        self.reached_us, self.received_s = NEVER_US, time.monotonic()
        self.ended = False
        self.error: BaseException | None = None
        self._source, self._reader = source, EventReader(source, source)
        self._waiting: deque[tuple[EventPacket, float]] = deque()

    def fill(self) -> None:
        """Take what has come."""
        missed = self._reader.lost_events
        try:
            while not self.ended and (found := self._reader.take()) is not None:
                self.received_s = found.received_s
                self._waiting.append((found.packet, found.received_s))
                self.reached_us = max(self.reached_us, found.packet.t_end_us)
        except EOFError:
            self.ended = True
        except Exception as error:  # raised where the windows are used
            self.ended, self.error = True, error
        self._source.losses.add("missed", self._reader.lost_events - missed)

    def close(self) -> None:
        self._reader.release()

    def arrived_s(self, t_us: int) -> float:
        """Return when the first packet arrived that reaches a time; it must be there."""
        return next(at_s for packet, at_s in self._waiting if packet.t_end_us >= t_us)

    def begin_us(self) -> int:
        """Return where the first packet begins, us."""
        return self._waiting[0][0].t_start_us

    def next_event_us(self) -> int | None:
        """Return the time of the first event that waits, us."""
        return next((int(packet.t[0]) for packet, _ in self._waiting if len(packet)), None)

    def take(self, start_us: int, end_us: int) -> EventPacket:
        """Return the events of a span; those before it are counted as late."""
        parts: list[EventPacket] = []
        while self._waiting and self._waiting[0][0].t_start_us < end_us:
            packet, at_s = self._waiting.popleft()
            late, last = (int(place) for place in packet.t.searchsorted((start_us, end_us)))
            self._source.losses.add("late", late)
            if last > late:
                span = max(start_us, packet.t_start_us), min(end_us, packet.t_end_us)
                parts.append(packet.part(late, last, *span))
            if packet.t_end_us > end_us:
                rest = packet.part(last, len(packet), end_us, packet.t_end_us)
                self._waiting.appendleft((rest, at_s))
                break
        if not parts:
            return EventPacket.empty(start_us, end_us, self._source.size)
        whole = parts[0] if len(parts) == 1 else EventPacket.concatenate(parts)
        return whole.part(0, len(whole), start_us, end_us)


class _Pace:
    """Says when a window is complete: all sensors are there, or those behind are silent."""

    def __init__(self, sensors: Sequence[_Sensor], silent_s: float, starting_s: float) -> None:
        self._sensors = sensors
        self._silent_s, self._starting_s = silent_s, starting_s
        self._last_us: int | None = None

    def await_window(self, start_us: int, end_us: int) -> bool:
        """Wait for a window; return False where none follows.

        Raises:
            SpikingTacError: Whatever reading a camera raised.
        """
        while (left_s := self._left_s(start_us, end_us)) is not None and left_s > 0.0:
            time.sleep(min(left_s, LOOK_S))
        for sensor in self._sensors:
            if sensor.error is not None:
                raise sensor.error
        return left_s is not None

    def _left_s(self, start_us: int, end_us: int) -> float | None:
        """Return how long to wait for a window, s: not at all at 0; None where none follows."""
        for sensor in self._sensors:
            sensor.fill()
        ahead = [sensor for sensor in self._sensors if sensor.reached_us >= end_us]
        behind = [sensor for sensor in self._sensors if sensor.reached_us < end_us]
        ended = [sensor for sensor in behind if sensor.ended]
        if any(sensor.reached_us >= start_us for sensor in ended):
            return None  # as two recordings do, the pair ends where one of them ends
        if ended:  # in silence: what the others have told by then still counts
            if self._last_us is None:
                self._last_us = max(sensor.reached_us for sensor in self._sensors)
            return 0.0 if end_us <= self._last_us else None
        if not behind:
            return 0.0
        if not ahead:
            return LOOK_S
        there_s = min(sensor.arrived_s(end_us) for sensor in ahead)
        return max(self._silent_until_s(sensor, there_s) for sensor in behind) - time.monotonic()

    def _silent_until_s(self, sensor: _Sensor, there_s: float) -> float:
        """Return until when a sensor is waited for whom another one has overtaken."""
        never = sensor.reached_us == NEVER_US
        return max(there_s, sensor.received_s) + (self._starting_s if never else self._silent_s)


def live_windows(
    sources: Sequence[EventSource], silent_s: float = SILENT_S, starting_s: float = STARTING_S
) -> Iterator[tuple[EventPacket, ...]]:
    """Yield the 1 ms windows of sensors that deliver as time passes, until one of them ends.

    Where all deliver, the windows are those of
    :func:`~spikingtac.contact.recording.paired_windows`, however the streams are packed.

    Args:
        sources: Cameras on one clock. Each is read in a thread of its own.
        silent_s: A camera that delivered nothing for so long is not waited for, s.
        starting_s: The same before its first delivery, s.

    Raises:
        RecordingError: No camera has delivered anything by the end.
        SpikingTacError: Whatever reading a camera raised.
    """
    sensors = [_Sensor(source) for source in sources]
    pace = _Pace(sensors, silent_s, starting_s)
    try:
        event_us = start_us = _origin(pace, sensors)
        while pace.await_window(start_us, start_us + WINDOW_US):
            window = tuple(one.take(start_us, start_us + WINDOW_US) for one in sensors)
            event_us = max([event_us, *(int(one.t[-1]) for one in window if len(one))])
            start_us = _next_start(sensors, start_us + WINDOW_US, event_us)
            yield window
    finally:
        for sensor in sensors:
            sensor.close()


def _origin(pace: _Pace, sensors: Sequence[_Sensor]) -> int:
    """Return where the first window begins: with the camera that began last, silent ones apart.

    Raises:
        RecordingError: No camera has delivered anything by the end.
    """
    if not pace.await_window(NEVER_US + 1, NEVER_US + 1 + WINDOW_US):
        raise RecordingError("the recording holds no events; check the file and the camera")
    begun = [sensor for sensor in sensors if sensor.reached_us > NEVER_US]
    origin_us = max(sensor.begin_us() for sensor in begun)
    for sensor in begun:
        sensor.take(NEVER_US, origin_us)
    return origin_us


def _next_start(sensors: Sequence[_Sensor], start_us: int, event_us: int) -> int:
    """Return where the next window begins: beyond a silence that is too long, at its end."""
    coming = [t for sensor in sensors if (t := sensor.next_event_us()) is not None]
    if start_us < event_us + SILENCE_LIMIT_US or not coming:
        return start_us
    return max(start_us, start_us + (min(coming) - start_us) // WINDOW_US * WINDOW_US)


class WatchedWindows:
    """Windows of a live stream, read at once in a thread, for a consumer that is busy between them.

    Each arrival is a heartbeat, whether it is used or not. The backlog is the time for which the
    oldest unused packet has waited, or the lag of the stream where it is longer.

    Args:
        source: The camera.
        watchdog: Receives every arrival, the backlog, and the stream's end or failure.
    """

    def __init__(self, source: EventSource, watchdog: Watchdog) -> None:
        self._source, self._watchdog = source, watchdog
        self._unused: deque[float] = deque()
        self._closed = self._skipped = self._ended = False
        self._passed_over = 0
        self._reader = EventReader(self._heard(), source)

    def __iter__(self) -> Iterator[Window]:
        """Yield the windows of 1 ms.

        Raises:
            DeviceError: The watchdog has tripped, or the consumer has stopped reading.
            SpikingTacError: Whatever reading the stream raised.
        """
        while not self._ended:
            self._skipped = False
            for window in windows(self._packets(), WINDOW_US):
                if window.t_end_us - window.t_start_us == WINDOW_US:
                    yield (window,)

    def skip(self) -> None:
        """Drop what waits, which is of the past; the windows begin anew."""
        self._reader.give_up()
        self._unused.clear()
        self._passed_over, self._skipped = self._reader.lost_events, True

    def close(self) -> None:
        """Read no further."""
        self._closed = True
        self._reader.close()

    def _packets(self) -> Iterator[EventPacket]:
        with suppress(EOFError):
            while not self._skipped:
                found = self._reader.take(POLL_S)
                if self._reader.lost_events > self._passed_over:
                    raise DeviceError("the events wait and are not read; what came was overwritten")
                if found is None:
                    self._watchdog.require_ok()
                    continue
                if self._unused:
                    self._unused.popleft()
                yield found.packet
            return
        self._ended = True

    def _heard(self) -> Iterator[EventPacket]:
        """Pass the packets on in the reading thread, and tell the watchdog of each."""
        clock = StreamClock()
        try:
            for packet in self._source:
                if self._closed:
                    return
                now_s = time.monotonic()
                self._unused.append(now_s)
                leap_s = clock.arrive(packet.t_end_us, now_s)
                behind_s = clock.backlog_s(packet.t_end_us, now_s)
                self._watchdog.beat(max(now_s - self._unused[0], behind_s))
                if leap_s > 0.0:
                    self._watchdog.time_jump(f"the sensor's clock leapt ahead by {leap_s:.1f} s")
                yield packet
            self._tell("the event stream ended")
        except BaseException as error:  # passed to the consumer, which raises it
            self._tell(f"{type(error).__name__}: {error}")
            raise

    def _tell(self, reason: str) -> None:
        if not self._closed:
            self._watchdog.disconnected(reason)
