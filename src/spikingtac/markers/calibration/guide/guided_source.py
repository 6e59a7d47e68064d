"""A source of events that reports, while it is read, what a calibration still lacks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from spikingtac.events.source import EventSource
from spikingtac.markers.calibration.guide.guide import CalibrationGuide, GuideView
from spikingtac.types import EventPacket, LossCounters

TELL_US = 2_000_000
"""Sensor time between two reports, us."""


class GuidedSource:
    """Passes packets on, shows them to a guide meanwhile, and may end when enough has moved.

    Every attribute that is not named here is the source's own (``path``, ``close``).

    Args:
        source: Where the events come from.
        guide: Sees the events.
        tell: Called with the guide's view every two seconds of sensor time, and at the end.
        until_ready: End once a calibration has all that it needs.
    """

    size: tuple[int, int]
    losses: LossCounters

    def __init__(
        self,
        source: EventSource,
        guide: CalibrationGuide,
        tell: Callable[[GuideView], None],
        *,
        until_ready: bool = False,
    ) -> None:
        self._source, self._guide, self._tell = source, guide, tell
        self._until_ready = until_ready

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # copies ask before there is a source
            raise AttributeError(name)
        return getattr(self._source, name)

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield the source's packets."""
        self._guide.reset()
        told_us: int | None = None
        for packet in self._source:
            self._guide.absorb(packet)
            yield packet
            told_us = packet.t_start_us if told_us is None else told_us
            if packet.t_end_us - told_us >= TELL_US:
                told_us = packet.t_end_us
                self._tell(self._guide.view())
            if self._until_ready and self._guide.complete:
                self._end()
                break
        self._tell(self._guide.view())

    def _end(self) -> None:
        close = getattr(self._source, "close", None)
        if close is not None:
            close()
