"""Packets of events as messages of a ring, each with its arrival, its trigger edges and losses."""

import json
import re
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CameraLostError, ConfigError, DeviceError
from spikingtac.events.camera import Address, Camera
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import FileSource, Rows
from spikingtac.stream.ring import CLOSED, HEIGHT, WIDTH, RingReader, SharedRing
from spikingtac.types import EventPacket, LossCounters

ROOM_BYTES = 16 << 20  # Room for events that wait for their users: 1.3 million, 0.4 s at 3 Mev/s.
SHARED_BYTES = 32 << 20  # The same of a ring that is shared under a name.

# Events of one message, and room of a ring for each of them, bytes: a message takes a fifth of
# the ring at most. A longer packet is cut.
MOST_EVENTS, ROOM_PER_EVENT = 1 << 17, 64

# A message: span, arrival and count of the events, and their columns t, x, y, p; then as JSON what
# the source has counted, and time, channel and edge of each trigger.
_HEAD = struct.Struct("<qqdI")
COLUMNS = (np.int64, np.uint16, np.uint16, np.bool_)

MISSED = "missed"  # Kind of loss: events that a user of a ring was too slow for.
LOOK_S = 0.0005  # Time between two looks at a ring that another process fills, s.
_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")


@dataclass(frozen=True, slots=True)
class Delivery:
    """What came at once.

    Attributes:
        packet: The events.
        received_s: When they were here, on the host's monotonic clock, s.
        triggers: The trigger edges that came with them.
    """

    packet: EventPacket
    received_s: float
    triggers: Triggers


def shared_name(name: str) -> str:
    """Return the name in shared memory of a ring that is shared under a name.

    Raises:
        ConfigError: The name holds other characters, or too many.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(f"{name!r} is no name to share under; up to 40 letters, digits, _ and -")
    return f"spikingtac-{name}"


def new_ring(size: tuple[int, int], room_bytes: int = ROOM_BYTES, share: str = "") -> SharedRing:
    """Return a ring for packets of a size, px, which others find where it is shared under a name.

    Raises:
        ConfigError: It is no name.
        DeviceError: Another process shares under it, or there is no room.
    """
    ring = SharedRing.create(room_bytes, shared_name(share) if share else None)
    ring.put(WIDTH, size[0])
    ring.put(HEIGHT, size[1])
    return ring


class PacketWriter:
    """Writes what a source yields into a ring.

    Args:
        ring: Where to.
        source: Its ``losses``, ``triggers`` and ``received_s`` go with the packets.
    """

    def __init__(self, ring: SharedRing, source: Any) -> None:
        self._ring, self._source = ring, source
        self._told: tuple[dict[str, int], NDArray[Any]] = {}, Triggers().rows  # losses and edges
        self._most = max(min(MOST_EVENTS, ring.room // ROOM_PER_EVENT), 1)

    def write(self, packet: EventPacket) -> None:
        """Write a packet, in parts where it is long."""
        for first in range(0, max(len(packet), 1), self._most):
            last = min(first + self._most, len(packet))
            begin_us = packet.t_start_us if first == 0 else int(packet.t[first])
            end_us = packet.t_end_us if last == len(packet) else int(packet.t[last - 1]) + 1
            self._publish(packet.part(first, last, begin_us, end_us))

    def write_rows(self, rows: Rows) -> None:
        """Write columns, which are in order."""
        if len(rows[3]):
            self.write(packet_of(rows, self._source.size))

    def finish(self) -> None:
        """Write what was counted after the last packet, and say that nothing follows."""
        losses, edges = self._told
        if self._source.losses != losses or len(self._edges()) != len(edges):
            self.write(EventPacket.empty(0, 0, self._source.size))
        self._ring.put(CLOSED, 1)

    def close(self) -> None:
        """Finish, and give the ring back."""
        self.finish()
        self._ring.close()

    def _edges(self) -> Triggers:
        return getattr(self._source, "triggers", None) or Triggers()

    def _publish(self, packet: EventPacket) -> None:
        losses, edges, told = dict(self._source.losses), self._edges().rows, self._told[1]
        last = len(told)
        # A source that is iterated again has forgotten the edges of before.
        fresh = edges[last:] if np.array_equal(edges[last - 1 : last], told[-1:]) else edges
        tail, self._told = json.dumps([losses, fresh.tolist()]).encode(), (losses, edges)
        received_s = getattr(self._source, "received_s", time.monotonic())
        head = _HEAD.pack(packet.t_start_us, packet.t_end_us, received_s, len(packet))
        columns = map(np.ascontiguousarray, (packet.t, packet.x, packet.y, packet.p), COLUMNS)
        self._ring.publish(head, *columns, tail, weight=len(packet))


class PacketReader:
    """A user of a ring of packets: takes them in order, and counts what it was too slow for.

    Args:
        ring: From :func:`new_ring`.
        losses: Counters to fill, its own unless given.
        from_now: Begin with the next packet, and count from then on.

    Attributes:
        ring: As given.
        losses: What the source has counted, by kind, and under ``missed`` what was missed here.
        error: What is raised at the end.
    """

    def __init__(
        self, ring: SharedRing, losses: LossCounters | None = None, *, from_now: bool = False
    ) -> None:
        self.ring, self._reader = ring, RingReader(ring, from_now=from_now)
        self._size = ring.get(WIDTH), ring.get(HEIGHT)
        self.losses = LossCounters() if losses is None else losses
        self.error: BaseException = EOFError()
        # By the source, and missed here, up to the latest packet.
        self._counted: dict[str, int] | None = None if from_now else {}

    def take(self, timeout_s: float = 0.0) -> Delivery | None:
        """Return what came next, or None where nothing came in time.

        Raises:
            EOFError: The stream has ended, and everything was taken or missed.
            SpikingTacError: It failed, likewise.
        """
        until_s = time.monotonic() + timeout_s
        while True:
            written = self.ring.written  # asked first: the last events come before the end
            if (data := self._reader.next()) is not None:
                return self._delivery(data)
            if not written:
                self.give_up()
                raise self.error
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                return None
            self._wait(left_s)

    def give_up(self) -> None:
        """Count what waits as missed."""
        self._reader.give_up()
        self._count({})

    def _wait(self, seconds: float) -> None:
        """Wait for the next packet, but not longer."""
        time.sleep(min(seconds, LOOK_S))

    def _delivery(self, data: bytearray) -> Delivery:
        """Return the packet of a message; its columns are views of it."""
        begin_us, end_us, received_s, events = _HEAD.unpack_from(data)
        place, columns = _HEAD.size, []
        for kind in COLUMNS:
            columns.append(np.frombuffer(data, kind, events, place))
            place += columns[-1].nbytes
        t, x, y, p = columns
        losses, edges = json.loads(data[place:])
        triggers = Triggers()
        if edges:
            triggers.append(*zip(*edges, strict=True))
        self._count(losses)
        packet = EventPacket(x, y, p, t, begin_us, end_us, self._size, True)
        return Delivery(packet, received_s, triggers)

    def _count(self, told: dict[str, int]) -> None:
        before = told if self._counted is None else self._counted
        self._counted = {**before, **told, MISSED: self._reader.lost}
        for kind, count in self._counted.items():
            self.losses.add(kind, count - before.get(kind, 0))


def packet_of(rows: Rows, size: tuple[int, int]) -> EventPacket:
    """Return columns of some events, which are in order, as a packet."""
    x, y, p, t = rows
    return EventPacket(x, y, p, t, int(t[0]), int(t[-1]) + 1, size, True)


def shared_writer(source: Any, name: str) -> PacketWriter:
    """Return what shows the events of a source to others, as the camera ``ring:NAME``."""
    return PacketWriter(new_ring(source.size, SHARED_BYTES, name), source)


def at_once(source: FileSource) -> Iterator[EventPacket]:
    """Yield what came at once: nothing is held back, as a packet for a tracker would be.

    Args:
        source: A camera or a pipe, whose columns come checked.
    """
    for rows in source.columns():
        if len(rows[3]):
            yield packet_of(rows, source.size)


class RingCamera(Camera):
    """What another process reads, from now on, as a camera: ``ring:NAME``.

    Whoever reads a camera under an address with ``share=NAME`` opens its ring to others. They slow
    neither the reader nor each other: one that is too slow is told what it missed (``missed``).

    Attributes:
        published: Events that were published since it was opened.
    """

    checked = True

    def __init__(self, ring: SharedRing, name: str) -> None:
        super().__init__()
        self._name, self._packets = name, PacketReader(ring, self.losses, from_now=True)
        self.size = ring.get(WIDTH), ring.get(HEIGHT)
        self._ring: SharedRing | None = ring
        self.published, self._from = 0, ring.weight

    @classmethod
    def open(cls, address: Address) -> Self:
        """Attach; see :meth:`Camera.open`."""
        try:
            ring = SharedRing.attach(shared_name(address.target))
        except FileNotFoundError as error:
            raise DeviceError(
                f"nothing is shared under {address.target!r}; let its reader share it, as: "
                f"spikingtac record 'udp:7777?share={address.target}' -o FOLDER"
            ) from error
        if not ring.get(WIDTH) or not ring.written:
            ring.close()
            raise DeviceError(f"what was shared under {address.target!r} has ended; start it again")
        return cls(ring, address.target)

    def read(self, timeout_s: float) -> Rows | None:
        """Return the next events; see :meth:`Camera.read`."""
        if self._ring is None:
            return None
        try:
            found = self._packets.take(timeout_s)
        except EOFError as error:
            if self._ring.get(CLOSED):
                return None
            raise CameraLostError(f"the process that shared {self._name!r} is gone") from error
        self.published = self._ring.weight - self._from
        if found is None:
            return self.nothing()
        self.triggers.extend(found.triggers)
        packet = found.packet
        return packet.x, packet.y, packet.p, packet.t

    def close(self) -> None:
        """Leave the ring."""
        ring, self._ring = self._ring, None
        if ring is not None:
            ring.close()

    def describe(self) -> dict[str, Any]:
        """Return the name."""
        return {"shared_as": self._name}
