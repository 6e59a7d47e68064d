"""The events that another process reads, as a camera: ``ring:NAME``.

Whoever reads a camera under an address with ``share=NAME`` opens its ring to others. They slow
neither the reader nor each other: one that is too slow is told what it missed (``missed``).
"""

from __future__ import annotations

import time
from typing import Any, ClassVar, Self

from spikingtac.errors import CameraLostError, DeviceError
from spikingtac.events.address import Address
from spikingtac.events.camera import Camera
from spikingtac.events.formats.file_source import Rows
from spikingtac.stream.packets import PacketReader, told_size
from spikingtac.stream.reader import shared_name
from spikingtac.stream.reading import LOOK_S
from spikingtac.stream.ring import SharedRing

# A user that is so late goes on with the newest events, and is told what it missed, s (ours); and
# the most that an address may ask for: ``ring:NAME?late=60`` for one that records.
LATE_S, LONGEST_LATE_S = 1.0, 3600.0


class RingCamera(Camera):
    """What is read elsewhere, from now on.

    Attributes:
        published: Events that were published since it was opened.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = ("late",)
    checked = True

    def __init__(
        self, ring: SharedRing, size: tuple[int, int], name: str, late_s: float = LATE_S
    ) -> None:
        super().__init__()
        self._late_s = late_s
        self.size, self._name = size, name
        self._ring: SharedRing | None = ring
        self._reader, self._packets = ring.reader(from_now=True), PacketReader(size)
        self.published, self._from = 0, ring.weight
        self._told: dict[str, int] | None = None
        self._lost = 0

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
        size = told_size(ring)
        if size is None or not ring.written:
            ring.close()
            raise DeviceError(f"what was shared under {address.target!r} has ended; start it again")
        return cls(ring, size, address.target, address.number("late", LATE_S, 1e-3, LONGEST_LATE_S))

    def read(self, timeout_s: float) -> Rows | None:
        """Return the next events; see :meth:`Camera.read`."""
        until_s = time.monotonic() + timeout_s
        while (ring := self._ring) is not None:
            written = ring.written  # asked first: the last events come before the end
            data = self._reader.next()
            self.published = ring.weight - self._from
            if data is not None:
                return self._rows(data)
            if not written and not ring.finished:
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

    def _rows(self, data: bytearray) -> Rows:
        found = self._packets.delivery(data)
        if time.monotonic() - found.received_s > self._late_s:
            self._reader.give_up()  # the newest events matter more to who follows live
        if found.losses is not None:
            before = found.losses if self._told is None else self._told
            for kind, count in found.losses.items():
                self.losses.add(kind, count - before.get(kind, 0))
            self._told = dict(found.losses)
        self.losses.add("missed", self._reader.lost - self._lost)
        self._lost = self._reader.lost
        if found.triggers is not None:
            self.triggers.extend(found.triggers)
        packet = found.packet
        return packet.x, packet.y, packet.p, packet.t
