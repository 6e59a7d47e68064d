"""A stream of packets that passes a vibration monitor on its way."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from spikingtac.touch.vibration.event_vibration import EventVibrationMonitor, VibrationLine
from spikingtac.types import EventPacket

SLICE_US = 50_000
"""Packets are heard in slices of this length, so that long ones do not hide a change, us."""


class HeardPackets:
    """Passes packets on and keeps the line of every window that had one.

    Args:
        packets: Packets in order of time.
        monitor: What hears them, freshly made.

    Attributes:
        monitor: The same; let it follow the markers.
        lines: The lines so far.
    """

    def __init__(self, packets: Iterable[EventPacket], monitor: EventVibrationMonitor) -> None:
        self._packets, self.monitor = packets, monitor
        self.lines: list[VibrationLine] = []
        self._asked_us: int | None = None

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield the packets unchanged."""
        for packet in self._packets:
            self._hear(packet.sound())
            yield packet

    def _hear(self, packet: EventPacket) -> None:
        slices = range(packet.t_start_us, max(packet.t_end_us, packet.t_start_us + 1), SLICE_US)
        for start_us in slices:
            end_us = min(start_us + SLICE_US, packet.t_end_us)
            first, last = np.searchsorted(packet.t, [start_us, end_us])
            self.monitor.absorb(packet.part(int(first), int(last), start_us, end_us))
            self._ask(end_us)

    def _ask(self, t_us: int) -> None:
        if self._asked_us is None or t_us < self._asked_us:
            self._asked_us = t_us
        if t_us - self._asked_us >= self.monitor.window_us:
            self._asked_us = t_us
            line = self.monitor.line()
            if line is not None:
                self.lines.append(line)
