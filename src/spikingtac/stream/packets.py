"""Packets of events as messages of a ring, each with its arrival, its trigger edges and losses."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from spikingtac.events.formats.codec import Triggers
from spikingtac.stream.ring import NOTE, SharedRing
from spikingtac.types import EventPacket

# Events of one message, and room of a ring for each of them, bytes: a message takes a fifth of
# the ring at most. A longer packet is cut.
MOST_EVENTS, ROOM_PER_EVENT = 1 << 17, 64
_HEAD = struct.Struct("<qqdIII?3x")  # span, arrival, events, edges, bytes of losses, long times
SHORT_US = 1 << 32  # A packet that spans less has its times as four bytes each.
SIDE_BITS = 20


@dataclass(frozen=True, slots=True)
class Delivery:
    """What came at once.

    Attributes:
        packet: The events.
        received_s: When they were here, on the host's monotonic clock, s.
        triggers: The trigger edges that came with them, or None.
        losses: What the source has counted so far, by kind, where it has changed; else None.
    """

    packet: EventPacket
    received_s: float
    triggers: Triggers | None = None
    losses: Mapping[str, int] | None = None


def tell_size(ring: SharedRing, size: tuple[int, int]) -> None:
    """Say of which size the packets of a ring are, px."""
    ring.put(NOTE, size[0] << SIDE_BITS | size[1])


def told_size(ring: SharedRing) -> tuple[int, int] | None:
    """Return the size of a ring's packets, px; None before it is known."""
    found = ring.get(NOTE)
    return (found >> SIDE_BITS, found & ((1 << SIDE_BITS) - 1)) if found else None


class PacketWriter:
    """Writes what a source yields into a ring.

    Args:
        ring: Where to.
        source: Its ``losses``, ``triggers`` and ``received_s`` go with the packets.
    """

    def __init__(self, ring: SharedRing, source: Any) -> None:
        self._ring, self._source = ring, source
        self._losses: Mapping[str, int] = getattr(source, "losses", {})
        self._told, self._words, self._passed = {}, b"{}", 0
        self._most = max(min(MOST_EVENTS, ring.room // ROOM_PER_EVENT), 1)

    def messages(self, packet: EventPacket) -> Iterable[tuple[int, list[Any]]]:
        """Yield the number of events and the parts of each message of a packet."""
        for first in range(0, max(len(packet), 1), self._most):
            last = min(first + self._most, len(packet))
            whole = last - first == len(packet)
            begin_us = packet.t_start_us if first == 0 else int(packet.t[first])
            end_us = packet.t_end_us if last == len(packet) else int(packet.t[last - 1]) + 1
            part = packet if whole else packet.part(first, last, begin_us, end_us)
            yield last - first, self._parts(part)

    def finish(self) -> None:
        """Write what was counted after the last packet, and say that nothing follows."""
        last = getattr(self._source, "size", None)
        if last is not None and (self._told != self._losses or len(self._edges()) > self._passed):
            _, parts = next(iter(self.messages(EventPacket.empty(0, 0, last))))
            self._ring.publish(*parts)
        self._ring.finish()

    def _parts(self, packet: EventPacket) -> list[Any]:
        if self._told != self._losses:
            self._told = dict(self._losses)
            self._words = json.dumps(self._told).encode()
        edges = self._edges()
        edges = edges.select(slice(self._passed, None)) if len(edges) > self._passed else Triggers()
        self._passed += len(edges)
        first_us = int(packet.t[0]) if len(packet) else 0
        long = len(packet) > 0 and int(packet.t[-1]) - first_us >= SHORT_US
        received_s = getattr(self._source, "received_s", None) or time.monotonic()
        span = packet.t_start_us, packet.t_end_us, received_s
        head = _HEAD.pack(*span, len(packet), len(edges), len(self._words), long)
        t = packet.t if long else (packet.t - first_us).astype(np.uint32)
        parts = [head, first_us.to_bytes(8, "little", signed=True), _bytes(t, t.dtype)]
        parts += [_bytes(packet.x, np.uint16), _bytes(packet.y, np.uint16), _bytes(packet.p, bool)]
        if len(edges):
            parts += [_bytes(edges.t_us, np.int64), _bytes(edges.channel, np.uint8)]
            parts.append(_bytes(edges.edge, bool))
        return [*parts, self._words]

    def _edges(self) -> Triggers:
        return getattr(self._source, "triggers", None) or Triggers()


class PacketReader:
    """Turns the messages of a ring of packets into deliveries.

    Args:
        size: Of the packets, ``(width, height)``, px.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self._words = b"{}"

    def delivery(self, data: bytearray) -> Delivery:
        """Return what a message holds; its columns are views of the message."""
        begin_us, end_us, received_s, events, edges, length, long = _HEAD.unpack_from(data)
        first_us = int.from_bytes(data[_HEAD.size : _HEAD.size + 8], "little", signed=True)
        at = _Columns(data, _HEAD.size + 8)
        t = at.take(events, np.int64 if long else np.uint32)
        t = t if long else t.astype(np.int64) + first_us
        x, y, p = at.take(events, np.uint16), at.take(events, np.uint16), at.take(events, np.bool_)
        triggers = Triggers() if edges else None
        if triggers is not None:
            kinds = (np.int64, np.uint8, np.bool_)
            triggers.append(*(at.take(edges, kind) for kind in kinds))
        words, losses = bytes(data[at.place : at.place + length]), None
        if words != self._words:
            self._words, losses = words, json.loads(words)
        packet = EventPacket(x, y, p, t, begin_us, end_us, self._size, True)
        return Delivery(packet, received_s, triggers, losses)


class _Columns:
    def __init__(self, data: bytearray, place: int) -> None:
        self._data, self.place = data, place

    def take(self, count: int, kind: Any) -> Any:
        found = np.frombuffer(self._data, kind, count, self.place) if count else np.empty(0, kind)
        self.place += found.nbytes
        return found


def _bytes(column: Any, kind: Any) -> Any:
    """Return the bytes of a column without a copy where it is in one piece."""
    return np.ascontiguousarray(column, kind).data.cast("B")
