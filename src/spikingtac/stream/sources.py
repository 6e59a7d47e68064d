"""Sources of events that are read beside their user, and the ring of another reader as a camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from threading import Lock
from typing import Any, ClassVar, Self

from spikingtac.errors import CalibrationError, CameraLostError, DeviceError
from spikingtac.events.address import Address, is_stream
from spikingtac.events.camera import Camera
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.events.open import open_events
from spikingtac.stream.host import Asker, Factory, Host, closed_by
from spikingtac.stream.packets import PacketReader, at_once, shared_name, told_size
from spikingtac.stream.reader import END_S, POLL_S, EventReader
from spikingtac.stream.ring import SharedRing
from spikingtac.types import EventPacket, LossCounters

# A user that is so late goes on with the newest events, and is told what it missed, s; and the
# most that an address may ask for: ``ring:NAME?late=60`` for one that records.
LATE_S, LONGEST_LATE_S = 1.0, 3600.0
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
        inherit: As of :class:`~spikingtac.stream.host.Host`.
    """

    def __init__(
        self,
        opened: Factory[Iterable[tuple[EventPacket, Any]]],
        size: tuple[int, int],
        take_side_data: Callable[[Any], None] = lambda _: None,
        *,
        inherit: bool = False,
    ) -> None:
        self.size, self.losses = size, LossCounters()
        self._take = take_side_data
        self._host = Host(
            Factory(function=_simulate, arguments={"opened": opened}), inherit=inherit
        )

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


def _simulate(asker: Asker, opened: Factory[Iterable[tuple[EventPacket, Any]]]) -> None:
    """Tell the asker each packet with its side data; it waits while the channel is full."""
    for told in opened():
        asker.tell(told)
    asker.tell(())


class LiveSource(FileSource):
    """A camera or pipe that is read beside its user.

    Args:
        begin: Begins to read; called once, with the first use.
        size: ``(width, height)`` of the sensor, px.
        path: What is read.

    Attributes:
        received_s: When the latest events were here, on the monotonic clock, s.
    """

    checked = True

    def __init__(
        self, begin: Callable[[], EventReader], size: tuple[int, int], path: str | Path
    ) -> None:
        self._begin, self._reader, self._starting = begin, None, Lock()
        super().__init__(Path(path), ReadOptions(size=size))
        self.received_s = time.monotonic()

    @classmethod
    def in_process(cls, path: str, size: tuple[int, int] | None) -> LiveSource:
        """Return a camera that a process of its own reads; one that is unplugged is waited for.

        Args:
            path: Named pipe or address.
            size: ``(width, height)`` that the calibration is for, px; None takes any.

        Raises:
            SpikingTacError: There is no such camera, where its size was not known.
        """
        opened = Factory(function=opened_camera, arguments={"path": path, "size": size})
        reader = EventReader.in_process(opened, size)
        found = cls(lambda: reader, reader.size, path)
        found.start()
        return found

    def start(self) -> EventReader:
        """Begin to read; further calls, of any thread, return the same reader."""
        with self._starting:  # two readers of one camera would take each other's events
            self._reader = self._reader or self._begin()
            return self._reader

    def close(self) -> None:
        """End the iteration soon; what was read is still given out."""
        self.start().close()

    def _columns(self) -> Iterator[Rows]:
        reader = self.start()
        for delivery in reader:
            self.losses.update(reader.losses)
            self.received_s = delivery.received_s
            self.triggers.extend(delivery.triggers)
            packet = delivery.packet
            yield packet.x, packet.y, packet.p, packet.t
        self.losses.update(reader.losses)


def open_live(path: str | Path, *, strict: bool = False, sensor: int | None = None) -> FileSource:
    """Open events for one who follows them live: a camera is read in a thread.

    Args:
        path: A camera's address or a named pipe; or a file, as of
            :func:`~spikingtac.events.open.open_events`.
        strict: As there.
        sensor: As there.

    Raises:
        SpikingTacError: As there.
    """
    source = open_events(path, strict=strict, sensor=sensor)
    if not is_stream(Path(path)):
        return source
    return LiveSource(
        lambda: EventReader.in_thread(at_once(source), source), source.size, source.path
    )


def opened_camera(path: str, size: tuple[int, int] | None) -> FileSource:
    """Open a camera that is waited for where it is unplugged.

    Raises:
        CalibrationError: It has another size than its calibration.
    """
    source = open_events(path)
    if isinstance(source, CameraSource):
        source.when_lost = "reconnect"
    if size is not None and tuple(source.size) != tuple(size):
        raise CalibrationError(
            f"the calibration is for {size[0]}x{size[1]}, the camera is "
            f"{source.size[0]}x{source.size[1]}; calibrate this sensor"
        )
    return source


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
        if told_size(ring) is None or not ring.written:
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
                for kind, count in self._packets.losses.items():
                    self.losses.add(kind, count - self._told.get(kind, 0))
                self._told = dict(self._packets.losses)
                self.triggers.extend(found.triggers)
                packet = found.packet
                return packet.x, packet.y, packet.p, packet.t
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
