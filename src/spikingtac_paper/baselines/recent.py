"""The events of a recent time window, with their polarity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import EventPacket

Columns = tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.int64], NDArray[np.int64]]


class RecentEvents:
    """Stores packets until their events are too old."""

    def __init__(self) -> None:
        self._parts: list[Columns] = []

    def add(self, packet: EventPacket, polarity: NDArray[np.int64]) -> None:
        """Append the events of a packet. ``polarity`` ``(n,)`` is 1 for brighter, 0 for darker."""
        if len(packet):
            self._parts.append((packet.x, packet.y, polarity, packet.t))

    def drop_before(self, since_us: int) -> None:
        """Drop the events before ``since_us``."""
        self._parts = [part for part in self._parts if part[3][-1] >= since_us]
        if self._parts and self._parts[0][3][0] < since_us:
            x, y, polarity, t = self._parts[0]
            first = int(np.searchsorted(t, since_us))
            self._parts[0] = (x[first:], y[first:], polarity[first:], t[first:])

    def columns(self) -> Columns:
        """Return ``(n,)`` x, y, polarity and t of the stored events."""
        if not self._parts:
            none = np.empty(0, np.uint16)
            return none, none, np.empty(0, np.int64), np.empty(0, np.int64)
        x, y, polarity, t = zip(*self._parts, strict=True)
        return np.concatenate(x), np.concatenate(y), np.concatenate(polarity), np.concatenate(t)
