"""Turns columns that arrive piece by piece into packets whose spans follow without gaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import EventPacket

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
