"""The events of a recording, kept in memory to be read several times, also backwards."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.events.filters import BackgroundActivityFilter
from spikingtac.events.hot_pixels import find_hot_pixels, hot_mask, quiet_events
from spikingtac.events.source import EventSource
from spikingtac.types import EventPacket, LossCounters

LONGEST_US = int(np.iinfo(np.uint32).max)
"""Longest recording whose times fit 32 bits: 71 minutes."""

REPLAYED_US = 10_000
"""Length of the packets in which buffered events are read again, us."""


@dataclass(frozen=True, slots=True)
class BufferedEvents:
    """The events of a recording in 8 bytes each.

    Attributes:
        code: ``uint32[n]``, ``2 * (y * width + x)`` plus 1 where the pixel became brighter.
        time_us: ``uint32[n]`` since ``t_start_us``.
        size: ``(width, height)``, px.
        t_start_us: Where the recording begins, us.
        duration_us: Its length, us.
    """

    code: NDArray[np.uint32]
    time_us: NDArray[np.uint32]
    size: tuple[int, int]
    t_start_us: int
    duration_us: int

    def __len__(self) -> int:
        return len(self.code)

    @property
    def shape(self) -> tuple[int, int]:
        """``(height, width)`` of an image."""
        return (self.size[1], self.size[0])

    @property
    def pixels(self) -> int:
        """Number of pixels of the sensor."""
        return self.size[0] * self.size[1]

    def index_at(self, times_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many events came before each time since the start."""
        return np.searchsorted(self.time_us, times_us.clip(0, LONGEST_US).astype(np.uint32))

    def times_at(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the times of events by their number, us; of the last one where they end before."""
        return self.time_us[np.minimum(index, len(self) - 1)].astype(np.int64)

    def packet(self, index: tuple[int, int], span_us: tuple[int, int]) -> EventPacket:
        """Return the events from one index to another as a packet.

        Args:
            index: How many events came before the first one, and before the one after the last.
            span_us: Begin and end of the packet, us since the start.
        """
        code = self.code[index[0] : index[1]]
        pixel = code >> 1
        width = self.size[0]
        return EventPacket(
            x=(pixel % width).astype(np.uint16),
            y=(pixel // width).astype(np.uint16),
            p=(code & 1).astype(bool),
            t=self.time_us[index[0] : index[1]].astype(np.int64),
            size=self.size,
            t_start_us=int(span_us[0]),
            t_end_us=int(span_us[1]),
        )

    def inverted(self) -> BufferedEvents:
        """Return the same events with swapped polarities (dark markers become bright ones)."""
        return replace(self, code=self.code ^ np.uint32(1))


class BufferedSource:
    """Buffered events as a source that can be read repeatedly, unlike a camera.

    Args:
        events: The events.
    """

    def __init__(self, events: BufferedEvents) -> None:
        self.size = events.size
        self.losses = LossCounters()
        self._events = events

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield packets of equal duration with the recording's own times."""
        events, last_us = self._events, max(self._events.duration_us, 1)
        for begin_us in range(0, last_us, REPLAYED_US):
            end_us = min(begin_us + REPLAYED_US, last_us)
            first, last = events.index_at(np.array([begin_us, end_us], np.int64)).tolist()
            packet = events.packet((first, last), (begin_us, end_us))
            yield replace(
                packet,
                t=packet.t + events.t_start_us,
                t_start_us=begin_us + events.t_start_us,
                t_end_us=end_us + events.t_start_us,
                checked=True,
            )


def buffer_events(
    source: EventSource, most_events: int, most_us: int | None = None
) -> BufferedEvents:
    """Read a source once, to its end or for so long.

    Args:
        source: A recording, or a sensor that ends.
        most_events: Bound of the memory used: 8 bytes for each event.
        most_us: Time after which no more is read, us; None reads all.

    Raises:
        CalibrationError: The source holds no events, more than ``most_events``, or more than 71
            minutes; says how to cut it.
    """
    codes: list[NDArray[np.uint32]] = []
    times: list[NDArray[np.uint32]] = []
    start_us = end_us = events = 0
    for packet in source:
        start_us = start_us if codes else packet.t_start_us
        end_us = packet.t_end_us
        events += len(packet)
        if events > most_events or end_us - start_us > LONGEST_US:
            raise CalibrationError(
                f"the recording holds more than {most_events:,} events or 71 minutes; contacts of "
                "some ten seconds are enough, cut them out with: "
                "spikingtac convert RECORDING OUT --from-us N --to-us N"
            )
        codes.append(_coded(packet))
        times.append((packet.t - start_us).astype(np.uint32))
        if most_us is not None and end_us - start_us >= most_us:
            break
    if not events:
        raise CalibrationError(
            "the recording holds no events, so no marker can be found; record the sensor while "
            "something touches all of its skin"
        )
    return BufferedEvents(
        np.concatenate(codes), np.concatenate(times), source.size, start_us, end_us - start_us
    )


def without_hot_pixels(events: BufferedEvents) -> tuple[BufferedEvents, NDArray[np.int64]]:
    """Return the events of all pixels but the hot ones, and these ``(h, 2)``, columns and rows."""
    quiet, _ = quiet_events(events.time_us, 0, events.duration_us)
    pixel = events.code >> 1
    hot_px = find_hot_pixels(pixel[quiet].astype(np.int64), events.size)
    if not len(hot_px):
        return events, hot_px
    keep = ~hot_mask(hot_px, events.size).ravel()[pixel]
    return replace(events, code=events.code[keep], time_us=events.time_us[keep]), hot_px


def with_support(events: BufferedEvents) -> BufferedEvents:
    """Return the events that a neighbour supports: most of the noise is left out, little else."""
    packet = events.packet((0, len(events)), (0, events.duration_us))
    kept = BackgroundActivityFilter(events.size)(packet)
    return replace(events, code=_coded(kept), time_us=kept.t.astype(np.uint32))


def _coded(packet: EventPacket) -> NDArray[np.uint32]:
    packet = packet.sound()
    pixel = packet.y.astype(np.uint32) * np.uint32(packet.size[0]) + packet.x
    return pixel * np.uint32(2) + packet.p
