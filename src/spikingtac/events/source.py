"""One protocol for every origin of events: a file, a recording folder, a simulation, a camera."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from spikingtac.errors import ConfigError
from spikingtac.types import EventPacket, LossCounters


@runtime_checkable
class EventSource(Protocol):
    """A stream of events that is pulled, packet by packet.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        losses: What was lost or mended so far, by kind; complete when the iteration has ended.
    """

    size: tuple[int, int]
    losses: LossCounters

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield packets of any length that follow each other in time without gaps in their spans.

        A file may be iterated again from its beginning; a camera or a simulation goes on.
        """
        ...


class PacketSource:
    """An :class:`EventSource` over packets in memory, for tests and for sliced recordings."""

    def __init__(self, packets: list[EventPacket], size: tuple[int, int]) -> None:
        self.size = size
        self.losses = LossCounters()
        self._packets = packets

    def __iter__(self) -> Iterator[EventPacket]:
        return iter(self._packets)


def refuse_path(given: object) -> None:
    """Refuse a file's path where its events are expected.

    Raises:
        ConfigError: It is a path; says how to open it.
    """
    if isinstance(given, str | os.PathLike):
        path = os.fspath(given)
        raise ConfigError(
            f"{path!r} is a path, not a source of events; open it: spikingtac.open_events({path!r})"
        )
