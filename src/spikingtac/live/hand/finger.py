"""One finger in a process of its own: events in, frames into shared memory."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

from spikingtac.batch.worker_pool import end_with_parent
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError, SpikingTacError
from spikingtac.events.cameras.source import CameraSource
from spikingtac.events.formats.evt.raw_stream import RawStream
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.open import open_events
from spikingtac.live.hand.reading import pack
from spikingtac.live.ring import SharedRing
from spikingtac.markers.registry import make_tracker
from spikingtac.markers.tracking_config import TrackingConfig
from spikingtac.pipeline.checked_source import CheckedSource
from spikingtac.pipeline.follow import follow
from spikingtac.types import EventPacket, MarkerFrame

PLAY_US = 2_000
"""Length of the packets in which a recording is played, us (ours: a camera delivers as often)."""
NS_PER_US, NS_PER_MS = 1_000, 1_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class Finger:
    """A sensor of a hand.

    Attributes:
        source: A camera's address or a named pipe; a recording is played as fast as it was made.
        calibration: The sensor's ``calibration.json``.
        tracking: How markers are followed.
    """

    source: str | Path
    calibration: str | Path
    tracking: TrackingConfig = field(default_factory=TrackingConfig)


def run_finger(finger: Finger, ring: tuple[str, int], tell: Connection) -> None:
    """Follow a finger until its source ends; the first word of a process of its own.

    Args:
        finger: What to follow.
        ring: Name of the shared ring, and the bytes of a slot.
        tell: Gets ``("running", "")``, then ``("ended", "")`` or ``("failed", why)``, and
            ``("warning", why)`` where the calibration seems to be of another sensor.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the hand decides when to stop
    end_with_parent()
    try:
        _follow(finger, ring, tell)
    except Exception as error:  # told to the hand, which shows it
        known = isinstance(error, SpikingTacError | OSError)
        tell.send(("failed", str(error) if known else f"{type(error).__name__}: {error}"))
        return
    tell.send(("ended", ""))


def _follow(finger: Finger, ring: tuple[str, int], tell: Connection) -> None:
    calibration = Calibration.load(finger.calibration)
    source = open_events(str(finger.source))
    if source.size != calibration.size:
        raise CalibrationError(
            f"the sensor is {source.size[0]}x{source.size[1]}, its calibration is for "
            f"{calibration.size[0]}x{calibration.size[1]}; calibrate this sensor"
        )
    if isinstance(source, CameraSource):
        source.when_lost = "reconnect"
    clock = _Clock(source)
    checked = CheckedSource(clock, calibration, lambda why: tell.send(("warning", why)))
    tracker = make_tracker(finger.tracking, calibration)
    out = SharedRing.attach(*ring)
    tell.send(("running", ""))
    try:
        for number, frame in enumerate(follow(checked, tracker, finger.tracking.rate_hz), start=1):
            behind_ms = clock.behind_ms(frame)
            out.publish(pack(frame, time.monotonic_ns(), number, (behind_ms, clock.most_ms)))
    finally:
        out.close()


class _Clock:
    """A source whose packets come when they are due, and how far behind them the work is."""

    def __init__(self, source: FileSource) -> None:
        self._source = source
        self.size, self.losses = source.size, source.losses
        self._live = isinstance(source, CameraSource | RawStream)
        self._zero_ns: int | None = None
        self._came_ns = 0
        self.most_ms = 0.0

    def __iter__(self) -> Iterator[EventPacket]:
        for packet in self._source if self._live else _short(self._source):
            if not self._live:
                self._wait(packet.t_end_us)
            self._came_ns = time.monotonic_ns()
            yield packet

    def behind_ms(self, frame: MarkerFrame) -> float:
        """Return how long ago a frame was due, ms."""
        due_ns = self._came_ns
        if not self._live and self._zero_ns is not None:
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


def _short(source: FileSource) -> Iterator[EventPacket]:
    """Cut packets as a camera sends them."""
    for packet in source:
        for start_us in range(packet.t_start_us, packet.t_end_us, PLAY_US):
            end_us = min(start_us + PLAY_US, packet.t_end_us)
            first, last = packet.t.searchsorted((start_us, end_us))
            yield packet.part(int(first), int(last), start_us, end_us)
