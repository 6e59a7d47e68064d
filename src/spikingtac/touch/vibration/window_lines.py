"""The line of every window of a stream, one after another from its first event on."""

from __future__ import annotations

import numpy as np

from spikingtac.events.windows import SILENCE_LIMIT_US
from spikingtac.touch.vibration.event_vibration import EventVibrationMonitor, VibrationLine
from spikingtac.types import EventPacket


class WindowLines:
    """Gives events to a vibration monitor and asks it at the end of every window.

    Give it the packets of a tracker, cut at the estimates (:class:`SharedEventsTracker`), and let
    the monitor follow each frame: the lines do not depend on how the stream was packed.

    Args:
        monitor: What hears the events, freshly made.

    Attributes:
        monitor: The same.
        lines: The lines of the windows that had one, so far.
    """

    def __init__(self, monitor: EventVibrationMonitor) -> None:
        self.monitor = monitor
        self.lines: list[VibrationLine] = []
        self._asked_us: int | None = None
        self._last_us, self._end_us = 0, 0

    def absorb(self, packet: EventPacket) -> None:
        """Take in events in order of time; after a leap of time the windows begin anew.

        A leap is told from the events, as :func:`~spikingtac.events.windows.stretches` does: how
        far the packets before it reach into the silence depends on the packing.

        Raises:
            ConfigError: They are of another sensor.
        """
        window_us, start_us, first = self.monitor.window_us, packet.t_start_us, 0
        if self._leaps(packet):
            self._asked_us = None
        self._end_us = packet.t_end_us
        self._last_us = int(packet.t[-1]) if len(packet) else self._last_us
        if self._asked_us is None:
            if not len(packet):
                return
            self._asked_us = start_us = int(packet.t[0])
        while packet.t_end_us - self._asked_us >= window_us:
            self._asked_us += window_us
            last = int(np.searchsorted(packet.t, self._asked_us))
            begun_us = min(start_us, self._asked_us)
            self.monitor.absorb(packet.part(first, last, begun_us, self._asked_us))
            line = self.monitor.line()
            if line is not None:
                self.lines.append(line)
            start_us, first = self._asked_us, last
        self.monitor.absorb(packet.part(first, len(packet), start_us, packet.t_end_us))

    def _leaps(self, packet: EventPacket) -> bool:
        """Return whether time goes back before a packet, or far on without an event."""
        silent_us = int(packet.t[0]) - self._last_us if len(packet) else 0
        return packet.t_start_us < self._end_us or silent_us > SILENCE_LIMIT_US
