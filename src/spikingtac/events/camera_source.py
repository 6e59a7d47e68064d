"""A camera as a source of packets: counted, timed, and on request reconnected."""

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Literal

import numpy as np

from spikingtac.errors import CameraLostError, DeviceError, RecordingError
from spikingtac.events.camera import Address, Camera, open_camera
from spikingtac.events.clock import US_PER_S, ClockFit
from spikingtac.events.formats.codec import RESET_US
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.events.formats.packing import ColumnCheck

# What to do when a camera is gone: end the stream and count it, raise, or wait until it is back.
# A robot's guard must never reconnect: the watchdog has to trip.
WhenLost = Literal["end", "raise", "reconnect"]

# What shows the events of a camera to others; imported only where an address has ``share=NAME``.
SHARED_WRITER = "spikingtac.stream.packets:shared_writer"

POLL_S = 0.02  # Longest wait for a camera before the source looks whether it shall stop, s.

RETRY_S = 0.25  # Time between two attempts to open a camera that is gone, s (USB takes 0.5 s).
LONGEST_S = 1e7  # Largest value of the option ``seconds``.
RECENT_S = 2.0  # Time over which the rate is averaged, s.
LATEST = 1 << 15  # Deliveries whose intervals are reported: the latest 30 s at 1 kHz.


@dataclass(kw_only=True, slots=True)
class CameraHealth:
    """State of a camera; everything is counted since it was opened unless it says recent.

    Attributes:
        connected: False while it is gone.
        events: Events delivered.
        deliveries: Times that events came.
        rate_ev_s: Recent events per second.
        interval_p50_ms: Median time between the latest deliveries, ms; None before the second one.
        interval_p99_ms: 99th percentile of the same, ms.
        reconnects: How often it came back.
        away_s: Time for which it was gone, s.
        losses: What was lost or mended, by kind.
    """

    connected: bool = True
    events: int = 0
    deliveries: int = 0
    rate_ev_s: float = 0.0
    interval_p50_ms: float | None = None
    interval_p99_ms: float | None = None
    reconnects: int = 0
    away_s: float = 0.0
    losses: dict[str, int] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Return the figures, rounded for a report."""
        return {
            name: round(value, 3) if isinstance(value, float) else value
            for name, value in asdict(self).items()
        }

    @property
    def sentence(self) -> str:
        """What the interval means for latency, in plain words."""
        if self.interval_p50_ms is None:
            return "one delivery so far" if self.deliveries else "nothing was delivered yet"
        text = f"packets every {self.interval_p50_ms:.1f} ms (99 %: {self.interval_p99_ms:.1f} ms)"
        if self.interval_p50_ms > 1.0:
            text += ": a 1 ms window is not a 1 ms latency"
        return text


class DeliveryMeter:
    """Counts deliveries as they come.

    Args:
        clock_s: A monotonic clock, s.

    Attributes:
        counts: What is counted so far.
    """

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self.counts = CameraHealth()
        self._clock_s, self._opened_s = clock_s, clock_s()
        self._recent: deque[tuple[float, int]] = deque(maxlen=LATEST)

    def delivered(self, events: int, now_s: float) -> None:
        """Count one delivery."""
        self.counts.events += events
        self.counts.deliveries += 1
        self._recent.append((now_s, events))

    def came_back(self, away_s: float) -> None:
        """Count a camera that was gone for so long, s; its deliveries begin anew."""
        self.counts.connected = True
        self.counts.reconnects += 1
        self.counts.away_s += away_s
        self._recent.clear()

    def health(self, losses: dict[str, int]) -> CameraHealth:
        """Return the state now."""
        now_s = self._clock_s()
        latest = tuple(self._recent)
        recent = [count for at_s, count in latest if at_s > now_s - RECENT_S]
        intervals = np.diff([at_s for at_s, _ in latest]) * 1e3
        p50, p99 = np.percentile(intervals, (50, 99)).tolist() if len(intervals) else (None, None)
        rate_ev_s = sum(recent) / min(RECENT_S, max(now_s - self._opened_s, 1e-9))
        told = {"rate_ev_s": rate_ev_s, "interval_p50_ms": p50, "interval_p99_ms": p99}
        return replace(self.counts, losses=dict(losses), **told)


class CameraSource(FileSource):
    """Events of a camera, packet by packet as they come; shared where its address says so.

    A new iteration goes on where the last one ended. After a reconnect, and after a restart that
    took a while, the sensor's clock begins anew: its times are moved so that they go on from the
    last event by the host's clock. Where a loss is raised, a restart is not: a guard has to see it.

    Args:
        address: The camera's.
        options: ``strict`` and ``chunk_events`` as of a file; size and encoding stand in the
            address.
        when_lost: What happens when the camera is gone.

    Attributes:
        camera: The open camera.
        ended: Why the iteration ended: ``closed``, ``seconds``, ``ended`` (by itself) or ``lost``;
            empty before.
        clock: Learns how the sensor's clock maps to the host's.
        gaps: Stretches of sensor time for which the camera was gone, or restarted, us.
        received_s: When the latest packets' events were at hand, on the monotonic clock, s.

    Raises:
        ConfigError: The address is not understood.
        MissingExtraError: The camera's library is not installed.
        DeviceError: There is no such camera, or it refuses.
    """

    checked = True

    def __init__(self, address: Address, options: ReadOptions, when_lost: WhenLost = "end") -> None:
        self.address, self.when_lost = address, when_lost
        self._seconds = address.number("seconds", LONGEST_S, 1e-3, LONGEST_S)
        self.camera: Camera = open_camera(address)
        self.format = self.camera.format or f"{address.kind} camera"
        self._named_size = self.camera.size
        super().__init__(Path(str(address)), options)
        share = address.text("share")
        # Others attach to this ring as ring:NAME, whichever verb reads the camera.
        self._shared = resolve_name(SHARED_WRITER)(self, share) if share else None
        self.ended = ""
        self.received_s = time.monotonic()
        self.clock = ClockFit()
        self.gaps: list[dict[str, int]] = []
        self._meter = DeliveryMeter()
        self._closing = False
        # How much more time than the sensor tells has to have passed for its times to be moved, us.
        self._untold_us = math.inf
        self._offset_us = 0
        self._last_us, self._last_s = 0, self.received_s

    def health(self) -> CameraHealth:
        """Return how the camera delivers."""
        return self._meter.health(dict(self.losses.kinds()))

    def close(self) -> None:
        """End the iteration soon; may be called from another thread or a signal handler."""
        self._closing = True

    def release(self) -> None:
        """Close the camera; nothing can be read afterwards."""
        self._closing = True
        self._let_go()

    def _let_go(self) -> None:
        self.camera.close()
        self._take_counts()
        shared, self._shared = self._shared, None
        if shared is not None:
            shared.close()

    def _columns(self) -> Iterator[Rows]:
        check = None if self.camera.checked else ColumnCheck(self.size, self.losses)
        try:
            for rows in self._placed_rows():
                yield self._shown(rows if check is None else check(*rows))
            if check is not None:
                yield self._shown(check.finish())
        except Exception:
            self.ended = self.ended or "lost"
            raise
        finally:
            if self._closing or self.ended:
                self._let_go()

    def _shown(self, rows: Rows) -> Rows:
        if self._shared is not None:
            self._shared.write_rows(rows)
        return rows

    def _placed_rows(self) -> Iterator[Rows]:
        begun_s = time.monotonic()
        self.ended = ""
        while not (self.ended or self._closing):
            self.progress = min((time.monotonic() - begun_s) / self._seconds, 1.0)
            rows = self._read() if self.progress < 1.0 else None
            if rows is None:
                ended = "closed" if self._closing else "ended"
                self.ended = self.ended or ("seconds" if self.progress >= 1.0 else ended)
            elif len(rows[3]):
                yield self._placed(rows)
        self.ended = self.ended or "closed"

    def _read(self) -> Rows | None:
        try:
            rows = self.camera.read(POLL_S)
        except CameraLostError:
            self._take_counts()
            if self.when_lost == "raise":
                raise
            self.losses.add("disconnected")
            if self.when_lost == "reconnect":
                return self._reconnect()
            self.ended = "lost"
            return None
        self._take_counts()
        if rows is not None and len(rows[3]):
            self.received_s = time.monotonic()
            self._meter.delivered(len(rows[3]), self.received_s)
        return rows

    def _reconnect(self) -> Rows | None:
        """Wait for the camera; return no events, or None where the source was closed meanwhile."""
        gone_s = time.monotonic()
        self._meter.counts.connected = False
        self.camera.close()
        while not self._closing:
            try:
                camera = open_camera(self.address)
            except (DeviceError, RecordingError, OSError):
                time.sleep(RETRY_S)
                continue
            if camera.size != self.size:
                camera.close()
                raise DeviceError(
                    f"{self.address}: a camera of {camera.size[0]}x{camera.size[1]} px came back, "
                    f"it was {self.size[0]}x{self.size[1]}; plug in the same one"
                )
            self.camera, self._untold_us = camera, -math.inf
            self._meter.came_back(time.monotonic() - gone_s)
            self.losses.add("reconnected")
            return Camera.nothing()
        return None

    def _take_counts(self) -> None:
        """Move what the camera has counted to the source, which outlives it."""
        camera = self.camera
        for kind, count in camera.losses.items():
            self.losses.add(kind, count)
        if camera.losses["time_reset"] and self.when_lost != "raise":
            self._untold_us = min(self._untold_us, RESET_US)
        camera.losses.clear()
        edges = camera.triggers
        # A clock that begins anew is placed by its events.
        if len(edges) and self._untold_us == math.inf:
            self.triggers.append(edges.t_us + self._offset_us, edges.channel, edges.edge)
            edges.clear()

    def _placed(self, rows: Rows) -> Rows:
        """Return the columns with times that go on where the sensor's clock begins anew."""
        x, y, p, t = rows
        if self._untold_us < math.inf:
            until_us = self._last_us + round((self.received_s - self._last_s) * US_PER_S)
            untold_us = until_us - int(t[0]) - self._offset_us
            if self._last_us and untold_us >= self._untold_us:
                self._offset_us += untold_us
                self.gaps.append({"t_from_us": self._last_us, "t_to_us": until_us})
            self._untold_us = math.inf
            self.clock.forget()
            self._take_counts()
        if self._offset_us:
            t = t.astype(np.int64) + self._offset_us
        self._last_us, self._last_s = int(t[-1]), self.received_s
        self.clock.arrived(self._last_us, self.received_s)
        return x, y, p, t
