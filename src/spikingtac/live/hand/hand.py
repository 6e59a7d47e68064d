"""A hand: eight fingers, say, each in a process of its own, all read from one place."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Literal, Self

from spikingtac.batch.worker_pool import SINGLE_THREAD
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.live.hand.finger import Finger, run_finger
from spikingtac.live.hand.reading import Reading, reading_bytes, unpack
from spikingtac.live.ring import SharedRing

State = Literal["starting", "running", "ended", "failed", "killed"]
STOP_S = 2.0
"""Time for a finger's process to end."""
NS_PER_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class FingerHealth:
    """How a finger is.

    Attributes:
        state: ``starting``, ``running``, ``ended`` (its source has), ``failed`` (see ``why``), or
            ``killed`` (its process is gone).
        why: The error of a finger that failed; of one that runs, what its calibration has against
            the events; otherwise empty.
        frames: Frames so far.
        age_ms: Time since the latest frame, ms; None before the first.
        behind_ms: How much later than due the latest frame was shown, ms.
        most_behind_ms: The largest of these so far, ms.
        rate_ev_s: Events per second in the latest full tenth of a second.
        gaps: Stretches that were missing.
        overflows: Buffers that overran.
        damaged: Places that the decoder had to mend.
        reconnects: How often the camera came back.
        coasted: Markers that are predicted now, not observed.
    """

    state: State
    why: str = ""
    frames: int = 0
    age_ms: float | None = None
    behind_ms: float = 0.0
    most_behind_ms: float = 0.0
    rate_ev_s: float = 0.0
    gaps: int = 0
    overflows: int = 0
    damaged: int = 0
    reconnects: int = 0
    coasted: int = 0


class Hand:
    """Follows several sensors at once, each in its own process; a failure of one harms no other.

    The latest frame of each finger can be read at any time and costs some microseconds: nobody
    waits for anybody. Frames that were not read are gone.

    Args:
        fingers: Name -> sensor.

    Raises:
        ConfigError: There is no finger, or a calibration cannot be read.

    Example:
        >>> with st.Hand({"thumb": st.Finger(source="udp:7777", calibration="thumb.json")}) as hand:
        ...     thumb = hand.latest()["thumb"]  # doctest: +SKIP
    """

    def __init__(self, fingers: Mapping[str, Finger]) -> None:
        if not fingers:
            raise ConfigError("a hand needs a finger: Hand({'thumb': Finger(...)})")
        for name in SINGLE_THREAD:
            os.environ.setdefault(name, "1")
        markers = {
            name: len(Calibration.load(finger.calibration).reference_px)
            for name, finger in fingers.items()
        }
        self._fingers: dict[str, _Running] = {}
        try:
            for name, finger in fingers.items():
                self._fingers[name] = _Running(finger, markers[name])
        except BaseException:
            self.close()
            raise

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fingers, in their order."""
        return tuple(self._fingers)

    def latest(self) -> dict[str, Reading | None]:
        """Return the latest frame of each finger; None before its first."""
        return {name: finger.latest() for name, finger in self._fingers.items()}

    def health(self) -> dict[str, FingerHealth]:
        """Return how each finger is."""
        return {name: finger.health() for name, finger in self._fingers.items()}

    def process_id(self, name: str) -> int:
        """Return the id of a finger's process, to give it a core or a priority of its own."""
        process = self._fingers[name].process
        assert process.pid is not None  # it was started
        return process.pid

    def close(self) -> None:
        """End all processes and give the shared memory back."""
        for finger in self._fingers.values():
            finger.process.terminate()
        for finger in self._fingers.values():
            finger.close()
        self._fingers = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class _Running:
    """A finger's process, its ring, and what it told."""

    def __init__(self, finger: Finger, markers: int) -> None:
        self._markers = markers
        slot_bytes = reading_bytes(markers)
        self._ring = SharedRing.create(slot_bytes)
        # Fresh interpreters: a fork would copy locks whose threads it does not copy.
        context = multiprocessing.get_context("spawn")
        self._told, tell = context.Pipe(duplex=False)
        ring = (self._ring.name, slot_bytes)
        self.process = context.Process(target=run_finger, args=(finger, ring, tell), daemon=True)
        self.process.start()
        tell.close()  # its own end alone: its death shall close the pipe
        self._state: State = "starting"
        self._why = ""
        self._reading: Reading | None = None
        self._sequence = 0

    def latest(self) -> Reading | None:
        found = self._ring.latest(self._sequence)
        if found is not None:
            self._sequence, message = found
            self._reading = unpack(message, self._markers)
        return self._reading

    def health(self) -> FingerHealth:
        self._listen()
        reading = self.latest()
        if reading is None:
            return FingerHealth(self._state, self._why)
        return FingerHealth(
            self._state,
            self._why,
            reading.frames,
            (time.monotonic_ns() - reading.told_ns) / NS_PER_MS,
            reading.behind_ms,
            reading.most_behind_ms,
            reading.health.rate_ev_s,
            reading.health.gaps,
            reading.health.overflows,
            reading.health.damaged,
            reading.health.reconnects,
            int(reading.coasted.sum()),
        )

    def _listen(self) -> None:
        while (said := _received(self._told)) is not None:
            word, self._why = said
            self._state = self._state if word == "warning" else word
        if self._state in ("starting", "running") and not self.process.is_alive():
            self._state, self._why = "killed", "its process was ended from outside"

    def close(self) -> None:
        self.process.join(STOP_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.process.close()
        self._told.close()
        self._ring.close()


def _received(pipe: Connection) -> Any:
    try:
        return pipe.recv() if pipe.poll() else None
    except (EOFError, OSError):
        return None
