"""Windows: the events of one period, of one sensor or of several on one clock."""

from __future__ import annotations

from typing import TypeAlias

from spikingtac.types import EventPacket

WINDOW_US = 1_000  # Raw events are counted in windows of 1 ms (paper section V-B).

# The events of one period: of one sensor, or one packet per sensor, in the sensors' order.
Window: TypeAlias = EventPacket | tuple[EventPacket, ...]


def packets_of(window: Window) -> tuple[EventPacket, ...]:
    """Return the packets of a window, one per sensor."""
    return window if isinstance(window, tuple) else (window,)


def count_of(window: Window) -> int:
    """Return how many events a window holds, over all sensors."""
    if isinstance(window, tuple):
        return sum(len(packet) for packet in window)
    return len(window)
