"""What a finger shows to the others: one frame as bytes of a fixed length."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import MarkerFrame, SourceHealth

_HEAD = struct.Struct("<qqqdd4qd")  # t, told, frames, behind, most behind, health, rate
_FLOAT = np.dtype("<f4")


@dataclass(frozen=True, slots=True)
class Reading:
    """The latest frame of a finger.

    Attributes:
        t_us: Time of the frame on the sensor's clock, us.
        told_ns: When it was shown, by this host's ``time.monotonic_ns()``.
        frames: Number of frames so far.
        behind_ms: How much later than due it was shown: the work since the latest packet came, or
            for a recording that is played, since the frame's own time. ms
        most_behind_ms: The largest of these so far, ms.
        displacement_px: ``(m, 2)`` float32, px.
        coasted: ``(m,)`` True where a marker is predicted, not observed.
        health: State of the events.
    """

    t_us: int
    told_ns: int
    frames: int
    behind_ms: float
    most_behind_ms: float
    displacement_px: NDArray[np.float32]
    coasted: NDArray[np.bool_]
    health: SourceHealth


def reading_bytes(markers: int) -> int:
    """Return the length of a frame with so many markers, bytes."""
    return _HEAD.size + markers * (2 * _FLOAT.itemsize + 1)


def pack(frame: MarkerFrame, told_ns: int, frames: int, behind_ms: tuple[float, float]) -> bytes:
    """Return a frame as bytes; ``behind_ms`` is that of this frame, and the most so far."""
    health = frame.health
    counters = health.gaps, health.overflows, health.damaged, health.reconnects
    head = _HEAD.pack(frame.t_us, told_ns, frames, *behind_ms, *counters, health.rate_ev_s)
    return head + frame.displacement_px.astype(_FLOAT).tobytes() + frame.coasted.tobytes()


def unpack(message: bytes, markers: int) -> Reading:
    """Return the frame that :func:`pack` wrote."""
    t_us, told_ns, frames, behind_ms, most_ms, *health = _HEAD.unpack_from(message)
    moved = np.frombuffer(message, _FLOAT, 2 * markers, _HEAD.size).reshape(markers, 2)
    coasted = np.frombuffer(message, np.bool_, markers, _HEAD.size + moved.nbytes)
    return Reading(t_us, told_ns, frames, behind_ms, most_ms, moved, coasted, SourceHealth(*health))
