"""Sensors that are followed live, each in a process of its own, and read from any place.

A frame is in shared memory as soon as it is estimated. Nobody waits for anybody: a reader takes the
latest frame, or all of them in order, and is told how many it was too slow for.
"""

from __future__ import annotations

import asyncio
import os
import pickle
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from spikingtac.arrays import one_line
from spikingtac.batch.worker_pool import SINGLE_THREAD
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.events.address import is_stream
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.windows import windows
from spikingtac.markers.registry import TrackingConfig, make_tracker
from spikingtac.pipeline.follow import CheckedSource, follow
from spikingtac.pipeline.track import require_same_size
from spikingtac.stream.clock import US_PER_S, StreamClock
from spikingtac.stream.host import Asker, Host, closed_by, end_in_order
from spikingtac.stream.reader import opened_camera
from spikingtac.stream.ring import SharedRing
from spikingtac.types import EventPacket, MarkerFrame, SourceHealth

State = Literal["starting", "running", "ended", "failed", "killed"]
SLOTS = 2048  # Frames that a reader may be behind: 2 s at 1 kHz.
FRAME_BYTES, MARKER_BYTES = 256, 64  # Most bytes of a frame without markers, and of each marker.
LOOK_S = 0.0002  # Time between two looks for the next frame, s.
CLOCK_S = 1.0  # Time between two reports of the sensor's clock, s.

# A live source that is so late goes on with the newest events; lag at which it has caught up, and
# time over which its pace is looked at, s.
LATE_S, CAUGHT_UP_S, PACE_S = 1.0, 0.05, 0.1

# Length of the packets in which a recording is played, us (a camera delivers as often).
PLAY_US = 2_000
NS_PER_US, NS_PER_MS, NS_PER_S = 1_000, 1_000_000, 1_000_000_000


@dataclass(frozen=True, slots=True)
class LiveFrame(MarkerFrame):
    """A frame with when it was made.

    Attributes:
        number: Number of the frame, from 1 on.
        told_ns: When it was in shared memory, by this host's ``time.monotonic_ns()``.
        behind_ms: How much later than due that was, ms: the work since the latest packet came, or
            was due in a recording that is played.
        most_behind_ms: The largest of these so far, ms.
    """

    number: int = 0
    told_ns: int = 0
    behind_ms: float = 0.0
    most_behind_ms: float = 0.0

    __repr__ = one_line


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveHealth:
    """How a sensor is.

    Attributes:
        state: ``starting``, ``running``, ``ended`` (its source has), ``failed`` (see ``why``), or
            ``killed`` (its process is gone).
        why: The error of a sensor that failed; of one that runs, what its calibration has against
            the events; otherwise empty.
        frames: Frames so far.
        missed: Frames that the iteration was too slow for.
        age_ms: Time since the latest frame, ms; None before the first.
        behind_ms: How much later than due the latest frame was made, ms.
        most_behind_ms: The largest of these so far, ms.
        coasted: Markers that are predicted now, not observed.
        lost: What the events are known to have lost, and their rate.
        clock: The camera's clock on this host's (offset, drift and their errors); None of a
            recording, or before it is known.
    """

    state: State
    why: str = ""
    frames: int = 0
    missed: int = 0
    age_ms: float | None = None
    behind_ms: float = 0.0
    most_behind_ms: float = 0.0
    coasted: int = 0
    lost: SourceHealth = field(default_factory=SourceHealth)
    clock: Mapping[str, Any] | None = None


def live(
    source: str | Path,
    *,
    calibration: str | Path | Calibration,
    preset: str = "default",
    rate_hz: float | None = None,
) -> Live:
    """Follow a sensor live.

    Args:
        source: A camera's address, a named pipe, or a recording, which is played at its own speed.
        calibration: The sensor's, or the path of its ``calibration.json``.
        preset: ``default``, ``fast`` or ``paper``, or a TOML file.
        rate_hz: Frames per second; the preset's unless given.

    Raises:
        CalibrationError: The calibration cannot be read.
        ConfigError: There is no such preset.

    Example:
        >>> with st.live("openmv:/dev/ttyACM0", calibration="finger.json") as sensor:
        ...     for frame in sensor:
        ...         print(frame.displacement_px.max(), sensor.health.lost)  # doctest: +SKIP
    """
    if not isinstance(calibration, Calibration):
        calibration = Calibration.load(calibration)
    tracking = load_config(preset).with_tracking(rate_hz=rate_hz).tracking
    return Live(str(source), calibration, tracking)


class Live:
    """A sensor that is followed in a process of its own, until this object is closed.

    Iterating yields every frame in order, from the first one that is still there; ``async for``
    does the same. A second iteration goes on where the first one ended.
    """

    def __init__(self, source: str, calibration: Calibration, tracking: TrackingConfig) -> None:
        for name in SINGLE_THREAD:
            os.environ.setdefault(name, "1")
        largest_bytes = FRAME_BYTES + MARKER_BYTES * len(calibration.reference_px)
        self._ring = SharedRing.for_latest(largest_bytes, SLOTS)
        self._frames = self._ring.reader()
        given = {"source": source, "calibration": calibration, "tracking": tracking}
        self._host = Host(partial(follow_sensor, **given, ring=self._ring.name))
        self._state: State = "starting"
        self._why, self._error = "", None
        self._clock: Mapping[str, Any] | None = None
        self._frame: LiveFrame | None = None

    @property
    def process_id(self) -> int:
        """The process's id, to give it a core or a priority of its own."""
        return self._host.pid

    @property
    def health(self) -> LiveHealth:
        """How the sensor is now."""
        self._listen()
        told: dict[str, Any] = {"missed": self._frames.missed, "clock": self._clock}
        if (frame := self.latest()) is not None:
            told |= {
                "frames": frame.number,
                "age_ms": (time.monotonic_ns() - frame.told_ns) / NS_PER_MS,
                "behind_ms": frame.behind_ms,
                "most_behind_ms": frame.most_behind_ms,
                "coasted": int(frame.coasted.sum()),
                "lost": frame.health,
            }
        return LiveHealth(state=self._state, why=self._why, **told)

    def latest(self) -> LiveFrame | None:
        """Return the latest frame at once; None before the first."""
        found = self._ring.latest(self._frame.number if self._frame else 0)
        if found is not None:
            self._frame = unpack(found[1])
        return self._frame

    def __iter__(self) -> Iterator[LiveFrame]:
        """Yield the frames until the source ends.

        Raises:
            SpikingTacError: The sensor failed, or its process is gone.
        """
        while True:
            going = self._listen()  # asked first: the last frames come before the end
            for message in self._frames:
                yield unpack(message)
            if not going:
                break
            time.sleep(LOOK_S)
        if self._error is not None:
            raise self._error

    async def __aiter__(self) -> AsyncIterator[LiveFrame]:
        frames = iter(self)
        while (frame := await asyncio.to_thread(next, frames, None)) is not None:
            yield frame

    def close(self) -> None:
        """End the process and give the shared memory back."""
        self._host.close()
        self._ring.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _listen(self) -> bool:
        """Take what the process has told; False once nothing more comes."""
        try:
            while self._state in ("starting", "running"):
                told = self._host.receive()
                if told is None:
                    break
                word, value = told
                if word == "clock":
                    self._clock = value
                elif word == "warning":
                    self._why = value
                else:
                    self._state = word
        except EOFError:
            self._fail("killed", closed_by(self._host, "the sensor"))
        except Exception as error:
            self._fail("failed", error)
        return self._state in ("starting", "running")

    def _fail(self, state: State, error: Exception) -> None:
        self._state, self._error, self._why = state, error, str(error)


def follow_sensor(
    asker: Asker, source: str, calibration: Calibration, tracking: TrackingConfig, ring: str
) -> None:
    """Follow a sensor until its source ends; the whole work of its process."""
    end_in_order()
    # Kernels are compiled, or loaded, before time passes: by two events of each polarity.
    tracker = make_tracker(tracking, calibration)
    x, y = (np.full(4, side // 2, np.uint16) for side in calibration.size)
    polarity, t_us = np.array([True, False, True, False]), np.arange(4, dtype=np.int64)
    tracker.absorb(EventPacket(x, y, polarity, t_us, 0, PLAY_US, calibration.size))
    tracker.estimate(PLAY_US)
    # Read here: a thread would wait for the tracker's turns of the interpreter, and a process of
    # its own adds 0.2 ms. What comes meanwhile waits in the system's buffers.
    events = opened_camera(source)
    require_same_size(events.size, calibration.size)
    paced = PacedSource(events, lambda clock: asker.tell(("clock", clock)))
    checked = CheckedSource(paced, calibration, lambda why: asker.tell(("warning", why)))
    out = SharedRing.attach(ring)
    asker.tell(("running", ""))
    frames = follow(checked, make_tracker(tracking, calibration), tracking.rate_hz)
    for number, frame in enumerate(frames, 1):
        behind_ms, health = paced.pace.behind_ms(), frame.health
        lost = health.gaps, health.overflows, health.damaged, health.reconnects, health.rate_ev_s
        columns = frame.detected_px, frame.position_px, frame.displacement_px
        table = np.column_stack((*columns, frame.coasted, frame.confidence)).tobytes()
        made = number, time.monotonic_ns(), behind_ms, paced.pace.most_ms
        out.publish(pickle.dumps((frame.t_us, table, lost, made), pickle.HIGHEST_PROTOCOL))
    out.close()
    asker.tell(("ended", ""))


def unpack(message: bytes | bytearray) -> LiveFrame:
    """Return the frame of a message of :func:`follow_sensor`."""
    t_us, table, lost, made = pickle.loads(message)
    columns = np.frombuffer(table).reshape(-1, MARKER_BYTES // 8).T
    places = (columns[first : first + 2].T for first in (0, 2, 4))
    return LiveFrame(t_us, *places, columns[6] > 0.0, columns[7], SourceHealth(*lost), *made)


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
            if isinstance(self._source, CameraSource) and now_s - told_s > CLOCK_S:
                told_s, mapping = now_s, self._source.clock.mapping()
                if mapping is not None:
                    self._tell_clock(mapping.clock_summary())
            if skips:
                self.losses.add("missed", len(packet))
            else:
                yield packet
