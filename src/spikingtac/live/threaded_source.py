"""Reads a live stream in a thread, so that a consumer at work elsewhere leaves no pipe full.

The watchdog is beaten when windows arrive, not when they are used; how long the oldest unused one
has waited is its backlog.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Iterator

from spikingtac.contact.window import Window
from spikingtac.errors import DeviceError
from spikingtac.live.contact_loop import Arrival
from spikingtac.robot.watchdog import Watchdog

ROOM_WINDOWS = 1 << 16
"""Windows that may wait: a minute of them; a consumer that far behind has left."""
LOOK_S = 0.05
"""How often a waiting consumer looks at the watchdog, s."""


class ThreadedSource:
    """Windows of a live stream, taken off it at once and given out in order.

    Args:
        arrivals: The stream; it is opened and read in the pump's thread.
        watchdog: Told of every arrival, of the backlog, and of the stream's end or failure.
    """

    def __init__(self, arrivals: Iterable[Arrival], watchdog: Watchdog) -> None:
        self._arrivals, self._watchdog = arrivals, watchdog
        self._waiting: deque[Arrival] = deque()
        self._changed = threading.Condition()
        self._over: BaseException | None = None
        self._left = False
        self._thread = threading.Thread(target=self._run, name="spikingtac-pump", daemon=True)
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
        """Drop what waits: of the past, once nobody needs it any more."""
        with self._changed:
            self._waiting.clear()

    def close(self) -> None:
        """Read no further; what waits is dropped."""
        self._left = True

    def _next(self) -> Arrival | None:
        with self._changed:
            while not self._waiting and self._over is None:
                self._watchdog.require_ok()
                self._changed.wait(LOOK_S)
            if self._waiting:
                return self._waiting.popleft()
        if isinstance(self._over, StopIteration):
            return None
        assert self._over is not None
        raise self._over

    def _run(self) -> None:
        try:
            for arrival in self._arrivals:
                if self._left:
                    return
                self._take(arrival)
            self._end(StopIteration(), "the event stream ended")
        except BaseException as error:  # handed to the consumer, who raises it
            self._end(error, f"{type(error).__name__}: {error}")

    def _take(self, arrival: Arrival) -> None:
        with self._changed:
            if len(self._waiting) >= ROOM_WINDOWS:
                raise DeviceError(f"{ROOM_WINDOWS} windows wait, and nobody takes them")
            self._waiting.append(arrival)
            self._watchdog.beat(arrival.received_s - self._waiting[0].received_s)
            self._changed.notify()

    def _end(self, error: BaseException, reason: str) -> None:
        with self._changed:
            self._over = error
            self._changed.notify()
        if not self._left:
            self._watchdog.disconnected(reason)
