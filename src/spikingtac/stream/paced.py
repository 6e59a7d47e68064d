"""Events when they are due: recordings at their own speed, and live sources without a pile."""

import time
from collections.abc import Callable, Iterator
from typing import Any

from spikingtac.events.camera import is_stream
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.windows import windows
from spikingtac.stream.clock import US_PER_S, StreamClock
from spikingtac.types import EventPacket

CLOCK_S = 1.0  # Time between two reports of the sensor's clock, s.

# A live source that is so late goes on with the newest events; lag at which it has caught up, and
# time over which its pace is looked at, s.
LATE_S, CAUGHT_UP_S, PACE_S = 1.0, 0.05, 0.1

# Length of the packets in which a recording is played, us (a camera delivers as often).
PLAY_US = 2_000
NS_PER_US, NS_PER_MS, NS_PER_S = 1_000, 1_000_000, 1_000_000_000


class Pace:
    """Plays what was recorded at the speed of its recording, and tells how late the work is.

    Attributes:
        due_ns: When the latest data were due, by this host's ``time.monotonic_ns()``.
        most_ms: The most that the work was behind, ms.
    """

    def __init__(self) -> None:
        self._zero_ns: int | None = None  # host time of the data's zero
        self.due_ns, self.most_ms = 0, 0.0

    def wait(self, t_us: int) -> None:
        """Return when recorded data of this time are due, at once where they are late."""
        now_ns = time.monotonic_ns()
        if self._zero_ns is None:
            self._zero_ns = now_ns - t_us * NS_PER_US
        self.due_ns = self._zero_ns + t_us * NS_PER_US
        time.sleep(max(self.due_ns - now_ns, 0) / NS_PER_S)

    def behind_ms(self) -> float:
        """Return how long ago the latest data were due, ms."""
        behind_ms = max(time.monotonic_ns() - self.due_ns, 0) / NS_PER_MS
        self.most_ms = max(self.most_ms, behind_ms)
        return behind_ms


class PacedSource:
    """A source whose packets come when they are due.

    Of a live source that is late by :data:`LATE_S` the packets that wait are left out, and counted
    as missed: the newest ones matter more.

    Args:
        source: A camera, a pipe or a recording.
        tell_clock: Told the camera's clock, about once a second.

    Attributes:
        pace: Tells how far behind the packets the work is.
    """

    def __init__(
        self, source: FileSource, tell_clock: Callable[[dict[str, Any]], object] = lambda _: None
    ) -> None:
        self._source, self._tell_clock = source, tell_clock
        self.size, self.losses, self.pace = source.size, source.losses, Pace()

    def __iter__(self) -> Iterator[EventPacket]:
        if is_stream(self._source.path):
            yield from self._live()
        else:
            for packet in windows(self._source, PLAY_US):
                self.pace.wait(packet.t_end_us)
                yield packet

    def _live(self) -> Iterator[EventPacket]:
        clock, since = StreamClock(), (0, 0.0)  # sensor and host time of a look at the pace
        skips, told_s = False, 0.0
        for packet in self._source:
            t_us, now_s = packet.t_end_us, time.monotonic()
            clock.arrive(t_us, now_s)
            behind_s, looked_s = clock.lag_s(t_us, now_s), now_s - since[1]
            if looked_s > PACE_S:
                if skips and (t_us - since[0]) / US_PER_S <= looked_s:  # nothing waits any more
                    clock, behind_s = StreamClock(), 0.0
                since = t_us, now_s
            skips = behind_s > (CAUGHT_UP_S if skips else LATE_S)
            self.pace.due_ns = round(getattr(self._source, "received_s", now_s) * NS_PER_S)
            if skips:
                self.losses.add("missed", len(packet))
            else:
                yield packet
            if isinstance(self._source, CameraSource) and now_s - told_s > CLOCK_S:
                told_s, mapping = now_s, self._source.clock.mapping()
                if mapping is not None:
                    self._tell_clock(mapping.clock_summary())
