"""Sensors that are followed live, each in a process of its own, and read from any place.

A frame is in shared memory as soon as it is estimated. Nobody waits for anybody: a reader takes the
latest frame, or all of them in order, and is told how many it was too slow for.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, Self

from spikingtac.batch.worker_pool import SINGLE_THREAD
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.errors import ConfigError
from spikingtac.stream.host import Host, closed_by
from spikingtac.stream.ring import SharedRing
from spikingtac.stream.sensor import (
    NS_PER_MS,
    Finger,
    LiveFrame,
    follow_sensor,
    frame_layout,
    unpack,
)
from spikingtac.types import SourceHealth

State = Literal["starting", "running", "ended", "failed", "killed"]
SLOTS = 2048  # Frames that a reader may be behind: 2 s at 1 kHz.
LOOK_S = 0.0002  # Time between two looks for the next frame, s.


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
    tracking = load_config(preset).with_tracking(rate_hz=rate_hz).tracking
    return Live(Finger(source=source, calibration=calibration, tracking=tracking))


class Live:
    """A sensor that is followed in a process of its own, until this object is closed.

    Iterating yields every frame in order, from the first one that is still there; ``async for``
    does the same. A second iteration goes on where the first one ended.
    """

    def __init__(self, finger: Finger) -> None:
        for name in SINGLE_THREAD:
            os.environ.setdefault(name, "1")
        given = finger.calibration
        known = given if isinstance(given, Calibration) else Calibration.load(given)
        self._layout = frame_layout(len(known.reference_px))
        self._ring = SharedRing.for_latest(self._layout.itemsize, SLOTS)
        self._frames = self._ring.reader()
        self._host = Host(
            partial(follow_sensor, finger=finger, calibration=known, ring=self._ring.name)
        )
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
            self._frame = unpack(*found, self._layout)
        return self._frame

    def __iter__(self) -> Iterator[LiveFrame]:
        """Yield the frames until the source ends.

        Raises:
            SpikingTacError: The sensor failed, or its process is gone.
        """
        while True:
            going = self._listen()  # asked first: the last frames come before the end
            for message in self._frames:
                yield unpack(self._frames.number, message, self._layout)
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


class Hand:
    """Follows several sensors at once, each in its own process; a failure of one harms no other.

    Args:
        fingers: Name -> sensor.

    Raises:
        ConfigError: There is no finger.
        CalibrationError: A calibration cannot be read.

    Example:
        >>> with st.Hand({"thumb": st.Finger(source="udp:7777", calibration="thumb.json")}) as hand:
        ...     thumb = hand.latest()["thumb"]  # doctest: +SKIP
    """

    def __init__(self, fingers: Mapping[str, Finger]) -> None:
        if not fingers:
            raise ConfigError("a hand needs a finger: Hand({'thumb': Finger(...)})")
        self.fingers: dict[str, Live] = {}
        try:
            for name, finger in fingers.items():
                self.fingers[name] = Live(finger)
        except BaseException:
            self.close()
            raise

    def latest(self) -> dict[str, LiveFrame | None]:
        """Return the latest frame of each finger; None before its first."""
        return {name: finger.latest() for name, finger in self.fingers.items()}

    def health(self) -> dict[str, LiveHealth]:
        """Return how each finger is."""
        return {name: finger.health for name, finger in self.fingers.items()}

    def close(self) -> None:
        """End all processes and give the shared memory back."""
        for finger in self.fingers.values():
            finger.close()
        self.fingers = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
