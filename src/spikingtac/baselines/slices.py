"""Whole slices of time out of packets of any length."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spikingtac.types import EventPacket


class SliceBuffer:
    """Joins and cuts packets into slices that lie on multiples of their length.

    Empty slices are left out: nothing here happens in silence.

    Args:
        slice_us: Length of a slice, us.
    """

    def __init__(self, slice_us: int) -> None:
        self._slice_us = slice_us
        self._waiting: list[EventPacket] = []
        self._slice = 0

    def take(self, packet: EventPacket) -> Iterator[EventPacket]:
        """Yield the slices that are complete once ``packet`` is known."""
        number = packet.t // self._slice_us
        bounds = np.append(np.flatnonzero(np.diff(number)) + 1, len(packet))
        first = 0
        for last in bounds.tolist():
            if first == last:
                continue
            if self._waiting and number[first] != self._slice:
                yield self._flush()
            self._slice = int(number[first])
            self._waiting.append(packet.part(first, last, packet.t_start_us, packet.t_end_us))
            first = last
        if self._waiting and packet.t_end_us >= (self._slice + 1) * self._slice_us:
            yield self._flush()

    def _flush(self) -> EventPacket:
        whole = EventPacket.concatenate(self._waiting)
        self._waiting = []
        return whole
