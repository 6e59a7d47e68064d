"""The process that follows one sensor: events in, frames into shared memory."""

from __future__ import annotations

import struct
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
from spikingtac.markers.registry import TrackingConfig, make_tracker
from spikingtac.pipeline.follow import CheckedSource, follow
from spikingtac.stream.clock import US_PER_S, StreamClock
from spikingtac.stream.host import Asker, end_in_order
from spikingtac.stream.reader import opened_camera
from spikingtac.stream.ring import SharedRing
from spikingtac.stream.sources import LATE_S
from spikingtac.types import EventPacket, MarkerFrame, SourceHealth

# Lag at which a source that was late has caught up, and time over which its pace is looked at, s.
CAUGHT_UP_S, PACE_S = 0.05, 0.1
CLOCK_S = 1.0  # Time between two reports of the sensor's clock, s.

# Length of the packets in which a recording is played, us (a camera delivers as often).
PLAY_US = 2_000
NS_PER_US, NS_PER_MS, NS_PER_S = 1_000, 1_000_000, 1_000_000_000
_HEAD = struct.Struct("<qqdd4qd")  # t, told, behind, most behind, health, rate
_COLUMNS = 8  # detected, position, displacement, confidence, coasted


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


def frame_bytes(markers: int) -> int:
    """Return the length of a frame with so many markers, bytes."""
    return _HEAD.size + markers * _COLUMNS * 8


def pack(frame: MarkerFrame, told_ns: int, behind_ms: tuple[float, float]) -> bytes:
    """Return a frame as bytes; ``behind_ms`` is that of this frame, and the most so far."""
    lost = frame.health
    counters = lost.gaps, lost.overflows, lost.damaged, lost.reconnects
    head = _HEAD.pack(frame.t_us, told_ns, *behind_ms, *counters, lost.rate_ev_s)
    columns = (frame.detected_px, frame.position_px, frame.displacement_px)
    return head + np.column_stack((*columns, frame.confidence, frame.coasted)).tobytes()


def unpack(number: int, message: bytes | bytearray, markers: int) -> LiveFrame:
    """Return the frame that :func:`pack` wrote."""
    t_us, told_ns, behind_ms, most_ms, *lost = _HEAD.unpack_from(message)
    table = np.frombuffer(message, np.float64, offset=_HEAD.size).reshape(markers, _COLUMNS)
    return LiveFrame(
        t_us=t_us,
        detected_px=table[:, 0:2],
        position_px=table[:, 2:4],
        displacement_px=table[:, 4:6],
        coasted=table[:, 7] > 0.0,
        confidence=table[:, 6],
        health=SourceHealth(*lost),
        number=number,
        told_ns=told_ns,
        behind_ms=behind_ms,
        most_behind_ms=most_ms,
    )


def calibration_of(finger: Finger) -> Calibration:
    """Return a sensor's calibration.

    Raises:
        CalibrationError: It cannot be read.
    """
    given = finger.calibration
    return given if isinstance(given, Calibration) else Calibration.load(given)


def follow_sensor(asker: Asker, finger: Finger, ring: str) -> None:
    """Follow a sensor until its source ends; the whole work of its process."""
    end_in_order()
    calibration = calibration_of(finger)
    _warm_up(finger.tracking, calibration)  # before time passes
    # Read here: a thread would wait for the tracker's turns of the interpreter, and a process of
    # its own adds 0.2 ms. What comes meanwhile waits in the system's buffers.
    source = opened_camera(str(finger.source), calibration.size)
    clock = _Clock(source, asker)
    checked = CheckedSource(clock, calibration, lambda why: asker.tell(("warning", why)))
    tracker = make_tracker(finger.tracking, calibration)
    out = SharedRing.attach(ring)
    asker.tell(("running", ""))
    for frame in follow(checked, tracker, finger.tracking.rate_hz):
        behind_ms = clock.behind_ms(frame)
        out.publish(pack(frame, time.monotonic_ns(), (behind_ms, clock.most_ms)))
    out.close()
    asker.tell(("ended", ""))


def _warm_up(tracking: TrackingConfig, calibration: Calibration) -> None:
    """Compile, or load, the kernels of a tracker by two events of each polarity."""
    tracker = make_tracker(tracking, calibration)
    x, y = (np.full(4, side // 2, np.uint16) for side in calibration.size)
    polarity, t_us = np.array([True, False, True, False]), np.arange(4, dtype=np.int64)
    tracker.absorb(EventPacket(x, y, polarity, t_us, 0, PLAY_US, calibration.size))
    tracker.estimate(PLAY_US)


class _Clock:
    """A source whose packets come when they are due, and how far behind them the work is.

    Of a live source that is late by :data:`LATE_S` the packets that wait are left out, and counted
    as missed: the newest ones matter more.
    """

    def __init__(self, source: FileSource, asker: Asker) -> None:
        self._source, self._asker = source, asker
        self.size, self.losses = source.size, source.losses
        self._live = is_stream(source.path)
        self._zero_ns: int | None = None
        self._came_ns = self._told_ns = 0
        self.most_ms = 0.0

    def __iter__(self) -> Iterator[EventPacket]:
        if not self._live:
            for packet in _short(self._source):
                self._wait(packet.t_end_us)
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
            self._came_ns = round(getattr(self._source, "received_s", now_s) * NS_PER_S)
            self._tell_clock()
            if skips:
                self.losses.add("missed", len(packet))
            else:
                yield packet

    def behind_ms(self, frame: MarkerFrame) -> float:
        """Return how long ago a frame was due, ms."""
        due_ns = self._came_ns
        if self._zero_ns is not None:
            due_ns = self._zero_ns + (frame.t_us + PLAY_US) * NS_PER_US
        behind_ms = max(time.monotonic_ns() - due_ns, 0) / NS_PER_MS
        self.most_ms = max(self.most_ms, behind_ms)
        return behind_ms

    def _wait(self, t_us: int) -> None:
        now_ns = time.monotonic_ns()
        if self._zero_ns is None:
            self._zero_ns = now_ns - t_us * NS_PER_US
        early_ns = self._zero_ns + t_us * NS_PER_US - now_ns
        if early_ns > 0:
            time.sleep(early_ns * 1e-9)

    def _tell_clock(self) -> None:
        now_ns = time.monotonic_ns()
        if isinstance(self._source, CameraSource) and now_ns - self._told_ns > CLOCK_S * NS_PER_S:
            self._told_ns, mapping = now_ns, self._source.clock.mapping()
            if mapping is not None:
                self._asker.tell(("clock", mapping.clock_summary()))


def _short(source: FileSource) -> Iterator[EventPacket]:
    """Cut packets as a camera sends them."""
    for packet in source:
        for start_us in range(packet.t_start_us, packet.t_end_us, PLAY_US):
            end_us = min(start_us + PLAY_US, packet.t_end_us)
            first, last = packet.t.searchsorted((start_us, end_us))
            yield packet.part(int(first), int(last), start_us, end_us)
