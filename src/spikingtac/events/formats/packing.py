"""Turns the columns of any file into sound packets whose spans follow without gaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.time_course import TIME_LIMIT_US, TimeCourse
from spikingtac.types import EventPacket, LossCounters

# Columns x, y, p and t of the package's types.
Sound = tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_], NDArray[np.int64]]


class ColumnCheck:
    """Drops what is outside of the sensor and keeps time monotonic.

    Args:
        size: ``(width, height)`` of the sensor, px.
        losses: Counters to fill.
    """

    def __init__(self, size: tuple[int, int], losses: LossCounters) -> None:
        self._width, self._height = size
        self._losses = losses
        self._course = TimeCourse(losses)
        self._held: Sound = _none()

    def __call__(self, x: NDArray[Any], y: NDArray[Any], p: NDArray[Any], t: NDArray[Any]) -> Sound:
        """Return sound columns; the last events may wait for the next call (see TimeCourse)."""
        inside = (x >= 0) & (x < self._width) & (y >= 0) & (y < self._height)
        if not inside.all():
            self._losses.add("out_of_range", int(len(inside) - np.count_nonzero(inside)))
            x, y, p, t = x[inside], y[inside], p[inside], t[inside]
        on = p if p.dtype == np.bool_ else p > 0
        columns: Sound = x.astype(np.uint16), y.astype(np.uint16), on, _whole(t)
        if len(self._held[0]):
            columns = _joined(self._held, columns)
        return self._mended(columns, final=False)

    def finish(self) -> Sound:
        """Return the events that still wait."""
        return self._mended(self._held, final=True)

    def _mended(self, columns: Sound, final: bool) -> Sound:
        x, y, p, t = columns
        time, count = self._course.mend(t, final)
        self._held = x[count:], y[count:], p[count:], t[count:]
        return x[:count], y[:count], p[:count], time


def _joined(first: Sound, second: Sound) -> Sound:
    x, y, p, t = (np.concatenate(pair) for pair in zip(first, second, strict=True))
    return x.astype(np.uint16), y.astype(np.uint16), p.astype(np.bool_), t.astype(np.int64)


def _none() -> Sound:
    words = np.empty(0, np.uint16)
    return words, words, np.empty(0, np.bool_), np.empty(0, np.int64)


def _whole(t: NDArray[Any]) -> NDArray[np.int64]:
    """Return times as whole microseconds within the limits (a copy where they were not)."""
    if t.dtype.kind == "f":
        t = np.rint(np.nan_to_num(t))
    if t.dtype.kind == "u":
        t = np.minimum(t, np.uint64(TIME_LIMIT_US))
    return np.clip(t, -TIME_LIMIT_US, TIME_LIMIT_US).astype(np.int64)


TIE_LIMIT = 1 << 22  # Events of one and the same microsecond that are held back at most.


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
        whole = EventPacket(x, y, p, t, self._start_us, int(t[-1]), self._size, True)
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
