"""The process that follows one sensor: events in, frames into shared memory."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from spikingtac.arrays import one_line
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.address import is_stream
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.windows import windows
from spikingtac.markers.registry import TrackingConfig, make_tracker
from spikingtac.pipeline.follow import CheckedSource, follow
from spikingtac.stream.clock import US_PER_S, StreamClock
from spikingtac.stream.host import Asker, end_in_order
from spikingtac.stream.packets import LATE_S
from spikingtac.stream.reader import opened_camera
from spikingtac.stream.ring import SharedRing
from spikingtac.types import EventPacket, MarkerFrame, SourceHealth

# Lag at which a source that was late has caught up, and time over which its pace is looked at, s.
CAUGHT_UP_S, PACE_S = 0.05, 0.1
CLOCK_S = 1.0  # Time between two reports of the sensor's clock, s.

# Length of the packets in which a recording is played, us (a camera delivers as often).
PLAY_US = 2_000
NS_PER_US, NS_PER_MS, NS_PER_S = 1_000, 1_000_000, 1_000_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class Finger:
    """A sensor and how it is followed.

    Attributes:
        source: A camera's address or a named pipe; a recording is played as fast as it was made.
        calibration: The sensor's calibration, or its ``calibration.json``.
        tracking: How markers are followed.
    """

    source: str | Path
    calibration: str | Path | Calibration
    tracking: TrackingConfig = field(default_factory=TrackingConfig)


@dataclass(frozen=True, slots=True)
class LiveFrame(MarkerFrame):
    """A frame with when it was made.

    Attributes:
        number: Number of the frame, from 1 on.
        told_ns: When it was in shared memory, by this host's ``time.monotonic_ns()``.
        behind_ms: How much later than due that was, ms: the work since the latest packet came, or
            for a recording that is played, since the frame's own time.
        most_behind_ms: The largest of these so far, ms.
    """

    number: int = 0
    told_ns: int = 0
    behind_ms: float = 0.0
    most_behind_ms: float = 0.0

    __repr__ = one_line


def frame_layout(markers: int) -> np.dtype[np.void]:
    """Return the layout of a frame with so many markers in shared memory."""
    return np.dtype([
        ("t_us", "i8"), ("told_ns", "i8"), ("behind_ms", "f8"), ("most_behind_ms", "f8"),
        ("counters", "i8", (4,)), ("rate_ev_s", "f8"),
        # Detected, position, displacement, confidence, coasted.
        ("markers", "f8", (markers, 8)),
    ])  # fmt: skip


def unpack(number: int, message: bytes | bytearray, layout: np.dtype[np.void]) -> LiveFrame:
    """Return the frame of a message of :func:`follow_sensor`."""
    told = np.frombuffer(message, layout)[0]
    table = told["markers"]
    gaps, overflows, damaged, reconnects = told["counters"].tolist()
    return LiveFrame(
        t_us=int(told["t_us"]),
        detected_px=table[:, 0:2],
        position_px=table[:, 2:4],
        displacement_px=table[:, 4:6],
        confidence=table[:, 6],
        coasted=table[:, 7] > 0.0,
        health=SourceHealth(gaps, overflows, damaged, reconnects, float(told["rate_ev_s"])),
        number=number,
        told_ns=int(told["told_ns"]),
        behind_ms=float(told["behind_ms"]),
        most_behind_ms=float(told["most_behind_ms"]),
    )


def follow_sensor(asker: Asker, finger: Finger, calibration: Calibration, ring: str) -> None:
    """Follow a sensor until its source ends; the whole work of its process."""
    end_in_order()
    # Kernels are compiled, or loaded, before time passes: by two events of each polarity.
    tracker = make_tracker(finger.tracking, calibration)
    x, y = (np.full(4, side // 2, np.uint16) for side in calibration.size)
    polarity, t_us = np.array([True, False, True, False]), np.arange(4, dtype=np.int64)
    tracker.absorb(EventPacket(x, y, polarity, t_us, 0, PLAY_US, calibration.size))
    tracker.estimate(PLAY_US)
    # Read here: a thread would wait for the tracker's turns of the interpreter, and a process of
    # its own adds 0.2 ms. What comes meanwhile waits in the system's buffers.
    paced = PacedSource(opened_camera(str(finger.source), calibration.size), asker)
    checked = CheckedSource(paced, calibration, lambda why: asker.tell(("warning", why)))
    out, layout = SharedRing.attach(ring), frame_layout(len(calibration.reference_px))
    asker.tell(("running", ""))
    tracker = make_tracker(finger.tracking, calibration)
    for frame in follow(checked, tracker, finger.tracking.rate_hz):
        lost, behind_ms = frame.health, paced.behind_ms(frame.t_us)
        counters = lost.gaps, lost.overflows, lost.damaged, lost.reconnects
        columns = frame.detected_px, frame.position_px, frame.displacement_px
        table = np.column_stack((*columns, frame.confidence, frame.coasted))
        told = frame.t_us, time.monotonic_ns(), behind_ms, paced.most_ms
        out.publish(np.array((*told, counters, lost.rate_ev_s, table), layout).tobytes())
    out.close()
    asker.tell(("ended", ""))


class PacedSource:
    """A source whose packets come when they are due, and how far behind them the work is.

    Of a live source that is late by :data:`LATE_S` the packets that wait are left out, and counted
    as missed: the newest ones matter more.

    Args:
        source: A camera, a pipe or a recording.
        asker: Told the camera's clock.

    Attributes:
        most_ms: The most that the work was behind, ms.
    """

    def __init__(self, source: FileSource, asker: Asker) -> None:
        self._source, self._asker = source, asker
        self.size, self.losses, self.most_ms = source.size, source.losses, 0.0
        self._due_ns = self._told_ns = 0  # of the latest packet; when the clock was told
        self._zero_ns: int | None = None  # host time at which a recording's time is zero

    def __iter__(self) -> Iterator[EventPacket]:
        if not is_stream(self._source.path):
            for packet in windows(self._source, PLAY_US):
                now_ns, end_ns = time.monotonic_ns(), packet.t_end_us * NS_PER_US
                if self._zero_ns is None:
                    self._zero_ns = now_ns - end_ns
                time.sleep(max(self._zero_ns + end_ns - now_ns, 0) / NS_PER_S)
                yield packet
            return
        clock, since = StreamClock(), (0, 0.0)  # sensor and host time of a look at the pace
        skips = False
        for packet in self._source:
            t_us, now_s = packet.t_end_us, time.monotonic()
            clock.arrive(t_us, now_s)
            behind_s, looked_s = clock.lag_s(t_us, now_s), now_s - since[1]
            if looked_s > PACE_S:
                if skips and (t_us - since[0]) / US_PER_S <= looked_s:  # nothing waits any more
                    clock, behind_s = StreamClock(), 0.0
                since = t_us, now_s
            skips = behind_s > (CAUGHT_UP_S if skips else LATE_S)
            self._due_ns = round(getattr(self._source, "received_s", now_s) * NS_PER_S)
            self._tell_clock()
            if skips:
                self.losses.add("missed", len(packet))
            else:
                yield packet

    def behind_ms(self, t_us: int) -> float:
        """Return how long ago a frame was due, ms."""
        due_ns = self._due_ns
        if self._zero_ns is not None:
            due_ns = self._zero_ns + (t_us + PLAY_US) * NS_PER_US
        behind_ms = max(time.monotonic_ns() - due_ns, 0) / NS_PER_MS
        self.most_ms = max(self.most_ms, behind_ms)
        return behind_ms

    def _tell_clock(self) -> None:
        now_ns = time.monotonic_ns()
        if isinstance(self._source, CameraSource) and now_ns - self._told_ns > CLOCK_S * NS_PER_S:
            self._told_ns, mapping = now_ns, self._source.clock.mapping()
            if mapping is not None:
                self._asker.tell(("clock", mapping.clock_summary()))
