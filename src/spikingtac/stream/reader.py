"""Reads a live stream in a thread, so that a busy consumer leaves no pipe full.

Each arriving window is a heartbeat for the watchdog, whether it is used or not. The backlog is the
time for which the oldest unused window has waited, or the lag of the stream where it is longer.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Iterator

from spikingtac.contact.window import Window
from spikingtac.errors import DeviceError
from spikingtac.robot.watchdog import Watchdog
from spikingtac.stream.clock import StreamClock
from spikingtac.stream.guard_loop import Arrival

ROOM_WINDOWS = 1 << 16
"""Most windows that may wait: a minute of them. A consumer that far behind has stopped reading."""
POLL_S = 0.05
"""Period at which a waiting consumer checks the watchdog, s."""


class ThreadedSource:
    """Windows of a live stream, read at once and yielded in order.

    Args:
        arrivals: The stream; it is opened and read in the thread.
        watchdog: Receives every arrival, the backlog, and the stream's end or failure.
    """

    def __init__(self, arrivals: Iterable[Arrival], watchdog: Watchdog) -> None:
        self._arrivals, self._watchdog = arrivals, watchdog
        self._waiting: deque[Arrival] = deque()
        self._clock = StreamClock()
        self._changed = threading.Condition()
        self._end_cause: BaseException | None = None
        self._closed = False
        self._thread = threading.Thread(
            target=self._run, name="spikingtac-stream-reader", daemon=True
        )
        self._thread.start()

    def __iter__(self) -> Iterator[Window]:
        """Yield the windows.

        Raises:
            DeviceError: The watchdog has tripped.
            SpikingTacError: Whatever reading the stream raised.
        """
        while (arrival := self._next()) is not None:
            yield arrival.window

    def skip(self) -> None:
        """Drop the waiting windows, which are of the past."""
        with self._changed:
            self._waiting.clear()

    def close(self) -> None:
        """Read no further; the waiting windows are dropped."""
        self._closed = True

    def _next(self) -> Arrival | None:
        with self._changed:
            while not self._waiting and self._end_cause is None:
                self._watchdog.require_ok()
                self._changed.wait(POLL_S)
            if self._waiting:
                return self._waiting.popleft()
        if isinstance(self._end_cause, StopIteration):
            return None
        assert self._end_cause is not None
        raise self._end_cause

    def _run(self) -> None:
        try:
            for arrival in self._arrivals:
                if self._closed:
                    return
                self._take(arrival)
            self._end(StopIteration(), "the event stream ended")
        except BaseException as error:  # passed to the consumer, which raises it
            self._end(error, f"{type(error).__name__}: {error}")

    def _take(self, arrival: Arrival) -> None:
        with self._changed:
            if len(self._waiting) >= ROOM_WINDOWS:
                raise DeviceError(f"{ROOM_WINDOWS} windows wait and are not read")
            self._waiting.append(arrival)
            waited_s = arrival.received_s - self._waiting[0].received_s
            leap_s = self._clock.arrive(arrival.end_us, arrival.received_s)
            behind_s = self._clock.backlog_s(arrival.end_us, arrival.received_s)
            self._watchdog.beat(max(waited_s, behind_s))
            if leap_s > 0.0:
                self._watchdog.time_jump(f"the sensor's clock leapt ahead by {leap_s:.1f} s")
            self._changed.notify()

    def _end(self, error: BaseException, reason: str) -> None:
        with self._changed:
            self._end_cause = error
            self._changed.notify()
        if not self._closed:
            self._watchdog.disconnected(reason)
