"""Slices of constant duration from packets of any length."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spikingtac.types import EventPacket


class SliceBuffer:
    """Joins and cuts packets into slices that begin at multiples of their length.

    Slices without events are omitted, because they do not change any tracker here.

    Args:
        slice_us: Length of a slice, us.
    """

    def __init__(self, slice_us: int) -> None:
        self._slice_us = slice_us
        self._pending: list[EventPacket] = []
        self._slice = 0

    def take(self, packet: EventPacket) -> Iterator[EventPacket]:
        """Yield the slices that ``packet`` completes."""
        number = packet.t // self._slice_us
        bounds = np.append(np.flatnonzero(np.diff(number)) + 1, len(packet))
        first = 0
        for last in bounds.tolist():
            if first == last:
                continue
            if self._pending and number[first] != self._slice:
                yield self._flush()
            self._slice = int(number[first])
            self._pending.append(packet.part(first, last, packet.t_start_us, packet.t_end_us))
            first = last
        if self._pending and packet.t_end_us >= (self._slice + 1) * self._slice_us:
            yield self._flush()

    def _flush(self) -> EventPacket:
        whole = EventPacket.concatenate(self._pending)
        self._pending = []
        return whole
