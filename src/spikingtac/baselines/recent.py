"""The events of the last moments, with their polarity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import EventPacket

Columns = tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.int64], NDArray[np.int64]]


class RecentEvents:
    """Keeps packets until they are too old."""

    def __init__(self) -> None:
        self._parts: list[Columns] = []

    def add(self, packet: EventPacket, side: NDArray[np.int64]) -> None:
        """Append a packet's events; ``side`` is 1 for brighter, 0 for darker."""
        if len(packet):
            self._parts.append((packet.x, packet.y, side, packet.t))

    def forget_before(self, since_us: int) -> None:
        """Drop the events before ``since_us``."""
        self._parts = [part for part in self._parts if part[3][-1] >= since_us]
        if self._parts and self._parts[0][3][0] < since_us:
            x, y, side, t = self._parts[0]
            first = int(np.searchsorted(t, since_us))
            self._parts[0] = (x[first:], y[first:], side[first:], t[first:])

    def columns(self) -> Columns:
        """Return x, y, side and t of the events that are kept."""
        if not self._parts:
            none = np.empty(0, np.uint16)
            return none, none, np.empty(0, np.int64), np.empty(0, np.int64)
        x, y, side, t = zip(*self._parts, strict=True)
        return np.concatenate(x), np.concatenate(y), np.concatenate(side), np.concatenate(t)
