"""What another process makes or reads: a simulation, and the ring of another reader as a camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, ClassVar, Self

from spikingtac.errors import CameraLostError, DeviceError
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.formats.file_source import Rows
from spikingtac.stream.host import Asker, Host, closed_by
from spikingtac.stream.packets import PacketReader, shared_name
from spikingtac.stream.ring import CLOSED, NOTE, SharedRing
from spikingtac.types import EventPacket, LossCounters

# A user that is so late goes on with the newest events, and is told what it missed, s; and the
# most that an address may ask for: ``ring:NAME?late=60`` for one that records.
LATE_S, LONGEST_LATE_S = 1.0, 3600.0
POLL_S = 0.05  # Longest wait for a simulation before it is asked whether it goes on, s.
END_S = 0.1  # Wait for how a process has ended, s.
LOOK_S = 0.0005  # Time between two looks at a ring that another process fills, s.


class RemoteSource:
    """A simulation in a process of its own; it waits for its user, and loses nothing.

    It is an :class:`~spikingtac.events.source.EventSource`. A simulated sensor costs about as much
    as a tracker; side by side in one process they would share an interpreter lock, and neither
    would keep up.

    Args:
        opened: Opens it there: packets with side data.
        size: ``(width, height)`` of the packets, px.
        take_side_data: Called with each packet's side data before the packet is yielded.
    """

    def __init__(
        self,
        opened: Callable[[], Iterable[tuple[EventPacket, Any]]],
        size: tuple[int, int],
        take_side_data: Callable[[Any], None] = lambda _: None,
    ) -> None:
        self.size, self.losses = size, LossCounters()
        self._take = take_side_data
        self._host = Host(partial(_simulate, opened=opened))

    def __iter__(self) -> Iterator[EventPacket]:
        while True:
            try:
                told = self._host.receive(POLL_S)
            except EOFError as error:
                self._host.wait(END_S)
                raise closed_by(self._host, "the events") from error
            if told == ():
                return
            if told is not None:
                packet, side_data = told
                self._take(side_data)
                yield packet

    def close(self) -> None:
        """Stop the other process."""
        self._host.close()


def _simulate(asker: Asker, opened: Callable[[], Iterable[tuple[EventPacket, Any]]]) -> None:
    """Tell the asker each packet with its side data; it waits while the channel is full."""
    for told in opened():
        asker.tell(told)
    asker.tell(())


class RingCamera(Camera):
    """What another process reads, from now on, as a camera: ``ring:NAME``.

    Whoever reads a camera under an address with ``share=NAME`` opens its ring to others. They slow
    neither the reader nor each other: one that is too slow is told what it missed (``missed``).

    Attributes:
        published: Events that were published since it was opened.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = ("late",)
    checked = True

    def __init__(self, ring: SharedRing, name: str, late_s: float = LATE_S) -> None:
        super().__init__()
        self._ring: SharedRing | None = ring
        self._name, self._packets = name, PacketReader(ring, from_now=True, late_s=late_s)
        self.size = self._packets.size
        self.published, self._from = 0, ring.weight
        self._told: dict[str, int] = {}

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
        if not ring.get(NOTE) or not ring.written:
            ring.close()
            raise DeviceError(f"what was shared under {address.target!r} has ended; start it again")
        return cls(ring, address.target, address.number("late", LATE_S, 1e-3, LONGEST_LATE_S))

    def read(self, timeout_s: float) -> Rows | None:
        """Return the next events; see :meth:`Camera.read`."""
        until_s = time.monotonic() + timeout_s
        while (ring := self._ring) is not None:
            written = ring.written  # asked first: the last events come before the end
            found = self._packets.next()
            self.published = ring.weight - self._from
            if found is not None:
                told, self._told = self._told, dict(self._packets.losses)
                for kind, count in self._told.items():
                    self.losses.add(kind, count - told.get(kind, 0))
                self.triggers.extend(found.triggers)
                packet = found.packet
                return packet.x, packet.y, packet.p, packet.t
            if not written and not ring.get(CLOSED):
                raise CameraLostError(f"the process that shared {self._name!r} is gone")
            if not written:
                return None
            if time.monotonic() >= until_s:
                return self.nothing()
            time.sleep(LOOK_S)
        return None

    def close(self) -> None:
        """Leave the ring."""
        ring, self._ring = self._ring, None
        if ring is not None:
            ring.close()

    def describe(self) -> dict[str, Any]:
        """Return the name."""
        return {"shared_as": self._name}
