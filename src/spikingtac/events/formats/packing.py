"""Turns columns that arrive piece by piece into packets whose spans follow without gaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.codec import RESET_US
from spikingtac.types import EventPacket, LossCounters

TIME_LIMIT_US = 1 << 60
"""Times and shifts beyond are not believed: 36,000 years, and room for the sum of both."""

RESTARTS_PER_CHUNK = 64
"""Restarts that are re-based in one chunk; more of them are noise, and held."""

TIE_LIMIT = 1 << 22
"""Events of one and the same microsecond that are held back at most."""


class Packer:
    """Checks columns once, where data enters, and cuts them into packets.

    Events of the last microsecond wait for the next piece, since more of them may follow: a packet
    ends before the next one begins.

    Args:
        size: ``(width, height)`` of the sensor, px.
        chunk_events: About how many events a packet holds.
    """

    def __init__(self, size: tuple[int, int], chunk_events: int) -> None:
        self._size = size
        self._chunk_events = chunk_events
        self._held = EventPacket.empty(0, 0, size)
        self._start_us: int | None = None

    def push(
        self,
        x: NDArray[Any],
        y: NDArray[Any],
        p: NDArray[Any],
        t: NDArray[np.int64],
    ) -> Iterator[EventPacket]:
        """Take (and copy) columns in order of time and on the sensor; yield what is complete."""
        if not len(t):
            return
        if self._start_us is None:
            self._start_us = int(t[0])
        if t[0] < self._start_us:
            t = np.maximum(t, self._start_us)
        whole = EventPacket(x, y, p, t, self._start_us, int(t[-1]), self._size)
        # Joining copies, also where nothing is held: the columns may be buffers of a decoder.
        whole = EventPacket.concatenate([self._held, whole])
        complete = int(np.searchsorted(whole.t, whole.t[-1]))
        if len(whole) - complete > TIE_LIMIT:
            complete = len(whole)
        if complete:
            end_us = int(whole.t[complete - 1]) + 1 if complete == len(whole) else int(whole.t[-1])
            yield from self._slices(whole.part(0, complete, self._start_us, end_us))
            self._start_us = end_us
        self._held = whole.part(complete, len(whole), self._start_us, self._start_us)

    def finish(self) -> Iterator[EventPacket]:
        """Yield the events of the last microsecond."""
        if len(self._held) and self._start_us is not None:
            last_us = int(self._held.t[-1]) + 1
            yield from self._slices(self._held.part(0, len(self._held), self._start_us, last_us))
            self._start_us = last_us
            self._held = EventPacket.empty(0, 0, self._size)

    def _slices(self, packet: EventPacket) -> Iterator[EventPacket]:
        first, start_us = 0, packet.t_start_us
        while len(packet) - first > self._chunk_events:
            cut = int(np.searchsorted(packet.t, packet.t[first + self._chunk_events]))
            if cut <= first:
                cut = int(np.searchsorted(packet.t, packet.t[first], side="right"))
            if cut >= len(packet):
                break
            end_us = int(packet.t[cut])
            yield packet.part(first, cut, start_us, end_us)
            first, start_us = cut, end_us
        yield packet.part(first, len(packet), start_us, packet.t_end_us)


class ColumnCheck:
    """Mends columns of any file: drops what is outside of the sensor, keeps time monotonic.

    Args:
        size: ``(width, height)`` of the sensor, px.
        losses: Counters to fill.
    """

    def __init__(self, size: tuple[int, int], losses: LossCounters) -> None:
        self._width, self._height = size
        self._losses = losses
        self._last_us: int | None = None
        self._offset_us = 0

    def __call__(
        self, x: NDArray[Any], y: NDArray[Any], p: NDArray[Any], t: NDArray[Any]
    ) -> tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_], NDArray[np.int64]]:
        """Return sound columns of the package's types."""
        inside = (x >= 0) & (x < self._width) & (y >= 0) & (y < self._height)
        if not inside.all():
            self._losses.add("out_of_range", int(len(inside) - np.count_nonzero(inside)))
            x, y, p, t = x[inside], y[inside], p[inside], t[inside]
        if t.dtype.kind == "f":
            t = np.rint(np.clip(np.nan_to_num(t), -TIME_LIMIT_US, TIME_LIMIT_US))
        time = self._monotonic(t.astype(np.int64))
        on = p if p.dtype == np.bool_ else p > 0
        return x.astype(np.uint16), y.astype(np.uint16), on, time

    def _monotonic(self, t: NDArray[np.int64]) -> NDArray[np.int64]:
        if not len(t):
            return t
        t = np.clip(t, -TIME_LIMIT_US, TIME_LIMIT_US) + self._offset_us
        last = int(t[0]) if self._last_us is None else self._last_us
        self._losses.add("time_glitch", _without_spikes(t, last))
        falls = np.flatnonzero(np.diff(t, prepend=last) <= -RESET_US)
        for index in falls[:RESTARTS_PER_CHUNK]:
            before = int(t[:index].max(initial=last))
            if t[index] <= before - RESET_US:
                shift = before - int(t[index])
                if self._offset_us + shift > TIME_LIMIT_US:
                    break
                t[index:] += shift
                self._offset_us += shift
                self._losses.add("time_reset")
        floor = np.maximum.accumulate(np.maximum(t, last))
        self._losses.add("time_backwards", int(np.count_nonzero(floor != t)))
        self._last_us = int(floor[-1])
        return floor


def _without_spikes(t: NDArray[np.int64], last: int) -> int:
    """Flatten, in place, single times far above both neighbours; return how many."""
    before = np.concatenate(([last], t[:-2]))
    spikes = np.flatnonzero((t[:-1] >= t[1:] + RESET_US) & (t[1:] >= before))
    t[spikes] = before[spikes]
    return len(spikes)
