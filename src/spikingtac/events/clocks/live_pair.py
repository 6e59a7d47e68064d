"""Two cameras read side by side: a thread each takes what comes, so that none waits for the other.

Both threads begin with the first use of either: an event that waited for its reader would arrive
late by the host's clock, through which the two cameras' clocks meet.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator

from spikingtac.events.cameras.source import CameraSource
from spikingtac.events.clocks.live_map import LiveMap
from spikingtac.events.clocks.retimed import RetimedSource
from spikingtac.events.clocks.time_map import TimeMap
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows

ROOM_EVENTS = 1 << 22
"""Events that wait for their reader: 1.4 s at 3 Mev/s. Beyond, the camera waits, and its own
buffers overrun, which is counted."""
POLL_S = 0.05
"""How often a waiting thread looks whether it shall end, s."""
SILENCE_S = 2.0
"""Wait of a camera that delivers for one that is silent, s (ours: cameras start within one)."""


class ReadAhead(FileSource):
    """A camera that is read in a thread.

    Args:
        camera: The camera.
        options: As of the camera.

    Attributes:
        beside: What begins to be read at the same time.
        live_map: Puts the times on another camera's clock, or None.
    """

    def __init__(self, camera: CameraSource, options: ReadOptions) -> None:
        self.camera = camera
        self.checked = camera.checked
        super().__init__(camera.path, options)
        self.format, self.notes = camera.format, list(camera.notes)
        self.beside: list[ReadAhead] = []
        self.live_map: LiveMap | None = None
        self._waiting: deque[Rows] = deque()
        self._events = 0
        self._changed = threading.Condition()
        self._ended = self._closing = False
        self._error: BaseException | None = None
        self._thread: threading.Thread | None = None

    def close(self) -> None:
        """End the iteration soon; what was read is still given out."""
        self._closing = True
        self.camera.close()

    def start(self) -> None:
        """Begin to read; further calls do nothing."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._read, name="spikingtac-read", daemon=True)
            self._thread.start()

    @property
    def ended(self) -> bool:
        """True once nothing more comes from the camera."""
        return self._ended

    @property
    def delivering(self) -> bool:
        """True while something waits for its reader."""
        return bool(self._waiting)

    def _size(self) -> tuple[int, int]:
        return self.camera.size

    def _columns(self) -> Iterator[Rows]:
        for source in (self, *self.beside):
            source.start()
        while (rows := self._next()) is not None:
            self._take_counts()
            x, y, p, t = rows
            yield x, y, p, t if self.live_map is None else self.live_map(t)
        self._take_counts()
        if self._error is not None:
            raise self._error

    def _take_counts(self) -> None:
        self.progress = self.camera.progress
        self.losses.update(self.camera.losses)
        self.triggers.clear()
        self.triggers.extend(self.camera.triggers)

    def _next(self) -> Rows | None:
        with self._changed:
            while not self._waiting and not self._ended:
                self._changed.wait(POLL_S)
            if not self._waiting:
                return None
            rows = self._waiting.popleft()
            self._events -= len(rows[3])
            self._changed.notify_all()
            return rows

    def _read(self) -> None:
        try:
            for x, y, p, t in self.camera.columns():
                with self._changed:
                    while self._events > ROOM_EVENTS and not self._closing:
                        self._changed.wait(POLL_S)
                    self._waiting.append((x.copy(), y.copy(), p.copy(), t.copy()))
                    self._events += len(t)
                    self._changed.notify_all()
        except BaseException as error:  # raised where the events are used
            self._error = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()


class OnAnotherClock(RetimedSource):
    """A camera's events on another camera's clock.

    A camera that is silent does not hold this one back: after ``SILENCE_S`` the events are given
    out with their own times, to the end, and ``own_clock`` is counted. When the silent camera
    begins after all, its times are put on this one's clock instead.

    Attributes:
        live_map: How the times are mapped now.
    """

    def __init__(self, source: ReadAhead, live_map: LiveMap, options: ReadOptions) -> None:
        super().__init__(source, live_map, options)
        self.live_map, self._camera = live_map, source

    def close(self) -> None:
        """End the iteration soon."""
        self._camera.close()

    def _columns(self) -> Iterator[Rows]:
        pair = self._camera.beside
        for source in pair:
            source.start()
        # Times that were given out cannot be corrected backwards: wait until both have delivered.
        begun_s: float | None = None
        while self.live_map.known is None and not any(source.ended for source in pair):
            time.sleep(POLL_S)
            if begun_s is None and self._camera.delivering:
                begun_s = time.monotonic()
            if begun_s is not None and time.monotonic() - begun_s > SILENCE_S:
                self._map = TimeMap()
                first, own = pair[0].camera, self._camera.camera
                pair[0].live_map = LiveMap(first.clock.mapping, own.clock.mapping)
                self.losses.add("own_clock")
                break
        yield from super()._columns()


def live_pair(
    first: CameraSource, second: CameraSource, options: ReadOptions
) -> tuple[ReadAhead, OnAnotherClock]:
    """Return two cameras such that the second one's times are on the first one's clock.

    Args:
        first: Its clock is the time base.
        second: The other one.
        options: As of both.
    """
    live_map = LiveMap(second.clock.mapping, first.clock.mapping)
    both = ReadAhead(first, options), ReadAhead(second, options)
    for source in both:
        source.beside.extend(both)
    return both[0], OnAnotherClock(both[1], live_map, options)
