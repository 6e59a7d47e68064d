"""Two cameras that are read side by side, on one clock and in step.

Their clocks meet at the host's. A camera without events does not tell what time it is: while it
delivers, it is waited for. Once it has been silent for a while by the host's clock, it is taken for
empty as far as the other one has come. Events that come afterwards for that time are too late:
they are counted, and not put where they do not belong, since events of a second in one window
are a contact.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.contact.detector import Window
from spikingtac.contact.recording import paired_windows
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.clock import PPM, TimeMap
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.recording import RetimedSource
from spikingtac.events.source import EventSource
from spikingtac.stream.packets import MISSED, Delivery
from spikingtac.stream.reader import EventReader
from spikingtac.types import EventPacket

# Time between two looks at the clocks, us: milliseconds are learned in it at first, microseconds
# later.
RENEW_US = 1_000_000

# Bounds of the correction of the pace: time goes on, at half to twice its pace.
SLOWEST, FASTEST = -0.5, 1.0

# A camera that delivered nothing for so long is silent, s (the slowest of the counterparts
# delivers within 0.07 s in 99 % while a skin moves, see results/cameras/latency.md).
SILENT_S = 0.1
STARTING_S = 2.0  # The same before its first delivery, s (cameras start within one).
LOOK_S = 0.001  # Time between two looks for events, s.
NEVER_US = -(1 << 62)


class LiveMap:
    """Puts the times of a camera on a clock that it shares with others: their host's, shifted.

    What is known of the camera's clock grows while it runs. A correction is spread over a second,
    so that times stay in order and nearly keep their intervals.

    Args:
        known: Tells how the camera's clock maps to the host's.
        shift_us: Host time less shared time, us; empty until a camera delivers, whose own clock the
            shared one then continues.
    """

    def __init__(self, known: Callable[[], TimeMap | None], shift_us: list[float]) -> None:
        self._known, self._shift_us = known, shift_us
        self._line = TimeMap()
        self._renew_us: float | None = None

    def __call__(self, t_us: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
        """Return ``(n,)`` times on the shared clock, us; they follow the earlier ones in order."""
        now_us = float(t_us[0]) if len(t_us) else 0.0
        found = self._known()
        if found is not None and (self._renew_us is None or now_us >= self._renew_us):
            if not self._shift_us:
                self._shift_us.append(found.at(now_us) - now_us)
            aim_us = here_us = found.at(now_us) - self._shift_us[0]
            if self._renew_us is not None:
                here_us = self._line.at(now_us)
            correction = min(max((aim_us - here_us) / RENEW_US, SLOWEST), FASTEST)
            pace = found.drift_ppm * PPM + correction
            self._line = TimeMap(own_us=now_us, base_us=here_us, drift_ppm=pace / PPM)
            self._renew_us = now_us + RENEW_US
        return self._line(t_us)


def live_pair(cameras: Sequence[CameraSource], options: ReadOptions) -> list[RetimedSource]:
    """Return cameras on one clock: that of whichever delivers first.

    Args:
        cameras: On their own clocks.
        options: As of the cameras.
    """
    shift_us: list[float] = []
    return [RetimedSource(one, LiveMap(one.clock.mapping, shift_us), options) for one in cameras]


class _Sensor:
    """What was read of one sensor and was not given out yet."""

    def __init__(self, source: EventSource) -> None:
        self.source, self.reader = source, EventReader(source, source)
        self.waiting: deque[Delivery] = deque()
        self.last: Delivery | None = None  # given out
        self.given_us, self.received_s = NEVER_US, time.monotonic()
        self.ended = False

    def fill(self) -> None:
        """Take what has come.

        Raises:
            SpikingTacError: Whatever reading the camera raised.
        """
        try:
            while (found := self.reader.take()) is not None:
                self.received_s = found.received_s
                self.waiting.append(found)
        except EOFError:
            self.ended = True
        self.source.losses.add(MISSED, self.reader.losses.pop(MISSED, 0))

    def packets(self, sensors: Sequence[_Sensor]) -> Iterator[EventPacket]:
        """Yield the packets; while it is silent, empty ones as far as the others have come."""
        while True:
            for sensor in sensors:
                sensor.fill()
            if self.waiting:
                self.last = self.waiting.popleft()
                packet = self.last.packet
                late = int(packet.t.searchsorted(self.given_us))
                self.source.losses.add("late", late)
                begin_us = max(packet.t_start_us, self.given_us)
                if packet.t_end_us > begin_us:
                    self.given_us = packet.t_end_us
                    yield packet.part(late, len(packet), begin_us, packet.t_end_us)
            elif self.ended:
                return
            elif ahead := self._overtaken(sensors):
                first_us = min(one.packet.t_start_us for one in ahead)
                begin_us = first_us if self.given_us == NEVER_US else self.given_us
                self.given_us = max(one.packet.t_end_us for one in ahead)
                yield EventPacket.empty(begin_us, self.given_us, self.source.size)
            else:
                time.sleep(LOOK_S)

    def _overtaken(self, sensors: Sequence[_Sensor]) -> list[Delivery]:
        """Return what others delivered beyond this one's time, and that has waited long enough."""
        until_s = time.monotonic() - (SILENT_S if self.last else STARTING_S)
        known = [one for sensor in sensors for one in (sensor.last, *sensor.waiting) if one]
        return [
            one
            for one in known
            if max(self.received_s, one.received_s) <= until_s
            and one.packet.t_end_us > self.given_us
        ]


def live_windows(sources: Sequence[EventSource]) -> Iterator[Window]:
    """Yield the 1 ms windows of sensors that deliver as time passes, until one of them ends.

    Where all deliver, the windows are those of
    :func:`~spikingtac.contact.recording.paired_windows`, however the streams are packed.

    Args:
        sources: Cameras on one clock. Each is read in a thread of its own.

    Raises:
        RecordingError: A camera has ended without any event.
        SpikingTacError: Whatever reading a camera raised.
    """
    sensors = [_Sensor(source) for source in sources]
    try:
        yield from paired_windows([one.packets(sensors) for one in sensors])
    finally:
        for sensor in sensors:
            sensor.reader.release()
