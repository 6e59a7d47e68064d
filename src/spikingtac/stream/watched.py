"""Windows of a camera for a consumer that is busy between them, under a watchdog's eyes.

Each arrival is a heartbeat, whether it is used or not. The backlog is the time for which the oldest
unused packet has waited, or the lag of the stream where it is longer.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress

from spikingtac.contact.window import WINDOW_US, Window
from spikingtac.errors import DeviceError
from spikingtac.events.source import EventSource
from spikingtac.events.windows import windows
from spikingtac.robot.watchdog import Watchdog
from spikingtac.stream.clock import StreamClock
from spikingtac.stream.reader import POLL_S, EventReader
from spikingtac.types import EventPacket


class WatchedWindows:
    """Windows of a live stream, read at once in a thread and yielded in order.

    Args:
        source: The camera.
        watchdog: Receives every arrival, the backlog, and the stream's end or failure.
    """

    def __init__(self, source: EventSource, watchdog: Watchdog) -> None:
        self._source, self._watchdog = source, watchdog
        self._unused: deque[float] = deque()
        self._closed = self._skipped = self._ended = False
        self._passed_over = 0
        self._reader = EventReader.in_thread(self._heard(), source)

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
