"""Events that are read at once into a ring, in a thread or a process beside their users.

Whoever is busy leaves no camera unread: the reader goes on, and a user that was too slow is told
how many events it has missed. Other processes attach to the ring of a reader by its name.
"""

from __future__ import annotations

import re
import time
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any

from spikingtac.errors import ConfigError
from spikingtac.stream.host import Factory, Host
from spikingtac.stream.packets import Delivery, PacketReader, tell_size, told_size
from spikingtac.stream.reading import Reading, ReadingProcess, ReadingThread, fill
from spikingtac.stream.ring import SharedRing
from spikingtac.types import EventPacket, LossCounters

ROOM_BYTES = 16 << 20  # Room for events that wait for their users: 1.8 million, 0.6 s at 3 Mev/s.
AHEAD_BYTES = 4 << 20  # Room of a simulation that waits for its user.
POLL_S = 0.05  # Longest wait of a user before it looks whether it shall end, s.
_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")


def shared_name(name: str) -> str:
    """Return the name in shared memory of a ring that is shared under a name.

    Raises:
        ConfigError: It is none.
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
    tell_size(ring, size)
    return ring


class EventReader:
    """A stream that is read into a ring, and the first of the ring's users.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        losses: What the source has counted so far, by kind, and under ``missed`` the events that
            this user was too slow for.
        received_s: When the latest packet that was taken was here, on the monotonic clock, s.
    """

    def __init__(self, ring: SharedRing, reading: Reading, waited_for: bool) -> None:
        self.ring, self._reading = ring, reading
        self._reader = ring.reader(waited_for=waited_for)
        self.losses, self.received_s = LossCounters(), time.monotonic()
        self._close_ring = weakref.finalize(self, ring.close)
        self._missed_before = 0
        while (size := told_size(ring)) is None:
            if reading.over():
                raise reading.outcome()
            reading.wait(POLL_S)
        self.size, self._packets = size, PacketReader(size)

    @classmethod
    def in_thread(
        cls, stream: Iterable[EventPacket], source: Any, ring: SharedRing | None = None
    ) -> EventReader:
        """Read a stream in a thread.

        Args:
            stream: The packets.
            source: Where they come from: its ``size``, ``losses`` and ``triggers``.
            ring: Where they wait for their users; one that is not shared unless given.
        """
        ring = ring or new_ring(source.size)
        return cls(ring, ReadingThread(stream, source, ring), False)

    @classmethod
    def in_process(
        cls,
        opened: Factory[Any],
        size: tuple[int, int] | None = None,
        take_side_data: Callable[[Any], None] | None = None,
        *,
        share: str = "",
        inherit: bool = False,
    ) -> EventReader:
        """Read a stream in a process of its own.

        Args:
            opened: Opens it there.
            size: Of the packets, ``(width, height)``, px; None waits until the source is open.
            take_side_data: Of a simulation, which yields packets with side data and waits for this
                user: takes what belongs to a packet before it is taken. None: it is a source.
            share: Name under which other processes attach; empty for none.
            inherit: As of :class:`~spikingtac.stream.host.Host`.

        Raises:
            SpikingTacError: It could not be opened.
        """
        waits = take_side_data is not None
        room = AHEAD_BYTES if waits else ROOM_BYTES
        ring = SharedRing.create(room, shared_name(share) if share else None)
        if size is not None:
            tell_size(ring, size)
        given = {"opened": opened, "name": ring.name, "waits": waits}
        host = Host(Factory(function=fill, arguments=given), inherit=inherit)
        try:
            return cls(ring, ReadingProcess(host, ring, take_side_data or (lambda _: None)), waits)
        except BaseException:
            host.close()
            raise

    @property
    def ended(self) -> bool:
        """True once nothing more comes."""
        return self._reading.over()

    @property
    def lost_events(self) -> int:
        """Events that this user was too slow for."""
        return self._reader.lost

    def take(self, timeout_s: float = 0.0) -> Delivery | None:
        """Return what came next, or None where nothing came in time.

        Raises:
            EOFError: The stream has ended, and everything was taken or missed.
            SpikingTacError: It failed, likewise.
        """
        until_s = time.monotonic() + timeout_s
        while True:
            over = self._reading.over()  # asked first: the last events come before the end
            data = self._reader.next()
            if data is not None:
                return self._delivery(data)
            if over:
                self._reader.give_up()
                self._count_missed()
                raise self._reading.outcome()
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                return None
            self._reading.wait(left_s)

    def __iter__(self) -> Iterator[Delivery]:
        """Yield what comes until the stream ends; see :meth:`take`."""
        with suppress(EOFError):
            while True:
                found = self.take(POLL_S)
                if found is not None:
                    yield found

    def give_up(self) -> None:
        """Count what waits as missed."""
        self._reader.give_up()
        self._count_missed()

    def close(self) -> None:
        """End the stream; what a thread has read by then can still be taken."""
        self._reading.close()

    def release(self) -> None:
        """End the stream, and give the ring back."""
        self._reading.close()
        self._close_ring()

    def _delivery(self, data: bytearray) -> Delivery:
        self._reading.over()  # what was told before these events
        found = self._packets.delivery(data)
        self.received_s = found.received_s
        if found.losses is not None:
            self.losses.update(found.losses)
            self._missed_before = found.losses.get("missed", 0)
        self._count_missed()
        return found

    def _count_missed(self) -> None:
        missed = self._missed_before + self._reader.lost
        if missed:
            self.losses["missed"] = missed
