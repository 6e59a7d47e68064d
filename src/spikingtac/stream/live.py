"""Sensors that are followed live, each in a process of its own, and read from any place.

A frame is in shared memory as soon as it is estimated. Nobody waits for anybody: a reader takes the
latest frame, or all of them in order, and is told how many it was too slow for.
"""

from __future__ import annotations

import asyncio
import os
import struct
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from spikingtac.batch.worker_pool import SINGLE_THREAD
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.events.source import PacketSource
from spikingtac.markers.registry import TrackingConfig, make_tracker
from spikingtac.pipeline.follow import CheckedSource, check_rate, follow
from spikingtac.pipeline.track import require_same_size
from spikingtac.stream.host import Asker, Host, end_in_order
from spikingtac.stream.paced import NS_PER_MS, PacedSource
from spikingtac.stream.reader import opened_camera
from spikingtac.stream.real_time import exempt_from_collection
from spikingtac.stream.ring import RingReader
from spikingtac.types import EventPacket, MarkerFrame, SourceHealth, one_line

State = Literal["starting", "running", "ended", "failed", "killed"]
SLOTS = 2048  # Frames that a reader may be behind: 2 s at 1 kHz.

# A frame in shared memory: time, number, when it was told, how late it was made, the most of that,
# and the health of its events; then seven numbers of each marker, and whether it is predicted.
HEAD, NUMBERS = struct.Struct("<qqqddqqqqd"), 7
LOOK_S = 0.0002  # Time between two looks for the next frame, s.

# Events that a tracker follows before its sensor starts, and the time that they take, us: long
# enough for a contact detector that learns from the first 0.3 s.
NOISE_EVENTS, NOISE_US = 40_000, 320_000


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
        state: ``starting``, ``running``, ``ended`` (its source has, or it was closed), ``failed``
            (see ``why``), or ``killed`` (its process is gone).
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
        ConfigError: There is no such preset, or the rate is not above 0.

    Example:
        >>> with st.live("openmv:/dev/ttyACM0", calibration="finger.json") as sensor:
        ...     for frame in sensor:
        ...         print(frame.displacement_px.max(), sensor.health.lost)  # doctest: +SKIP
    """
    if not isinstance(calibration, Calibration):
        calibration = Calibration.load(calibration)
    tracking = load_config(preset).with_tracking(rate_hz=rate_hz).tracking
    check_rate(tracking.rate_hz)
    return Live(str(source), calibration, tracking)


class Live(AbstractContextManager["Live"]):
    """A sensor that is followed in a process of its own, until this object is closed.

    Iterating yields every frame in order, from the first one that is still there; ``async for``
    does the same. A second iteration goes on where the first one ended. Once it is closed, an
    iteration ends, and the latest frame and the health stay.
    """

    def __init__(self, source: str, calibration: Calibration, tracking: TrackingConfig) -> None:
        for name in SINGLE_THREAD:
            os.environ.setdefault(name, "1")
        given = {"source": source, "calibration": calibration, "tracking": tracking}
        frame_bytes = HEAD.size + (8 * NUMBERS + 1) * len(calibration.reference_px)
        self._host = Host("the sensor", partial(follow_sensor, **given), SLOTS * frame_bytes)
        self._frames, self._newest = (RingReader(self._host.rings[0]) for _ in range(2))
        self._turn, self._closed = threading.Lock(), False
        self._state: State = "starting"
        self._why, self._error = "", None
        self._clock: Mapping[str, Any] | None = None
        self._frame: LiveFrame | None = None

    @property
    def health(self) -> LiveHealth:
        """How the sensor is now."""
        self._listen()
        told: dict[str, Any] = {"missed": self._frames.lost, "clock": self._clock}
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
        if (message := self._take(self._newest.latest)) is not None:
            self._frame = unpack(message)
        return self._frame

    def __iter__(self) -> Iterator[LiveFrame]:
        """Yield the frames until the source ends.

        Raises:
            SpikingTacError: The sensor failed, or its process is gone.
        """
        for frame in self._looks():
            if frame is None:
                time.sleep(LOOK_S)
            else:
                yield frame

    async def __aiter__(self) -> AsyncIterator[LiveFrame]:
        for frame in self._looks():
            if frame is not None:
                yield frame
            # Others have their turn; whoever is cancelled here has lost no frame.
            await asyncio.sleep(0.0 if frame else LOOK_S)

    def _looks(self) -> Iterator[LiveFrame | None]:
        """Yield the frames until the source ends, and None where the next one is not there yet."""
        while True:
            going = self._listen()  # asked first: the last frames come before the end
            while (message := self._take(self._frames.next)) is not None:
                yield unpack(message)
            if not going:
                break
            yield None
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """End the process and give the shared memory back."""
        self._listen()
        self.latest()
        with self._turn:
            self._closed = True
            self._host.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take(self, take: Callable[[], bytearray | None]) -> bytearray | None:
        """Take a message from the ring, or None once it is closed, maybe by another thread."""
        with self._turn:
            return None if self._closed else take()

    def _listen(self) -> bool:
        """Take what the process has told; False once nothing more comes."""
        going = ("starting", "running")
        with self._turn:
            try:
                while self._state in going and not self._closed:
                    if (told := self._host.receive()) is None:
                        return True
                    word, value = told
                    if word == "clock":
                        self._clock = value
                    elif word == "warning":
                        self._why = value
                    else:
                        self._state = word
            except EOFError:
                self._state = "ended"
            except Exception as error:
                self._state = "killed" if self._host.lost else "failed"
                self._error, self._why = error, str(error)
            if self._state in going:
                self._state = "ended"
        return False


def follow_sensor(
    asker: Asker, source: str, calibration: Calibration, tracking: TrackingConfig
) -> None:
    """Follow a sensor until its source ends; the whole work of its process."""
    end_in_order()
    tracker = make_tracker(tracking, calibration)
    # Kernels are compiled, or loaded, before time passes.
    rehearsed = CheckedSource(noise(calibration.size), calibration)
    for _ in follow(rehearsed, tracker, tracking.rate_hz):
        pass
    tracker.reset()
    exempt_from_collection()
    # Read here: a thread would wait for the tracker's turns of the interpreter, and a process of
    # its own adds 0.2 ms. What comes meanwhile waits in the system's buffers.
    events = opened_camera(source)
    require_same_size(events.size, calibration.size)
    paced = PacedSource(events, lambda clock: asker.tell(("clock", clock)))
    checked = CheckedSource(paced, calibration, lambda why: asker.tell(("warning", why)))
    asker.tell(("running", ""))
    for number, frame in enumerate(follow(checked, tracker, tracking.rate_hz), 1):
        behind_ms, health = paced.pace.behind_ms(), frame.health
        lost = health.gaps, health.overflows, health.damaged, health.reconnects, health.rate_ev_s
        made = number, time.monotonic_ns(), behind_ms, paced.pace.most_ms
        places = frame.detected_px, frame.position_px, frame.displacement_px
        table = map(np.ascontiguousarray, (*places, frame.confidence, frame.coasted))
        asker.rings[0].publish(HEAD.pack(frame.t_us, *made, *lost), *table)


def noise(size: tuple[int, int]) -> PacketSource:
    """Return events all over a sensor, which ask for every kernel of a tracker."""
    rng = np.random.default_rng(0)
    x, y = (rng.integers(0, side, NOISE_EVENTS).astype(np.uint16) for side in size)
    t_us = np.sort(rng.integers(0, NOISE_US, NOISE_EVENTS))
    packet = EventPacket(x, y, rng.random(NOISE_EVENTS) < 0.5, t_us, 0, NOISE_US, size)
    return PacketSource([packet], size)


def unpack(message: bytes | bytearray) -> LiveFrame:
    """Return the frame of a message of :func:`follow_sensor`."""
    t_us, number, told_ns, behind_ms, most_ms, *health = HEAD.unpack_from(message)
    count = (len(message) - HEAD.size) // (8 * NUMBERS + 1)
    numbers = np.frombuffer(message, np.float64, NUMBERS * count, HEAD.size)
    coasted = np.frombuffer(message, np.bool_, count, HEAD.size + numbers.nbytes)
    detected_px, position_px, displacement_px = numbers[: 6 * count].reshape(3, count, 2)
    columns = detected_px, position_px, displacement_px, coasted, numbers[6 * count :]
    return LiveFrame(t_us, *columns, SourceHealth(*health), number, told_ns, behind_ms, most_ms)
