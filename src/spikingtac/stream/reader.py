"""Events that are read at once into a ring, in a thread or a process beside their users.

Whoever is busy leaves no camera unread: the reader goes on, and a user that was too slow is told
how many events it has missed.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Any

from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import FileSource
from spikingtac.stream.host import Asker, Factory, Host, closed_by, end_in_order
from spikingtac.stream.packets import (
    ROOM_BYTES,
    Delivery,
    PacketReader,
    PacketWriter,
    at_once,
    new_ring,
    tell_size,
    told_size,
)
from spikingtac.stream.ring import SharedRing
from spikingtac.types import EventPacket

POLL_S = 0.05  # Longest wait of a user before it looks whether it shall end, s.
END_S = 0.1  # Wait for how a process has ended, s.


class ReadingThread:
    """A thread of this process that fills a ring."""

    def __init__(self, stream: Iterable[EventPacket], source: Any, ring: SharedRing) -> None:
        self._error: BaseException = EOFError()
        self._bell, self._source = threading.Event(), source
        self._thread = threading.Thread(
            target=self._run, args=(stream, ring), name="spikingtac-reader", daemon=True
        )
        self._thread.start()

    def over(self) -> bool:
        """Return whether nothing more comes."""
        self._bell.clear()
        return not self._thread.is_alive()

    def wait(self, seconds: float) -> None:
        """Wait for something new, but not longer."""
        self._bell.wait(seconds)

    def outcome(self) -> BaseException:
        """Return what ended the stream: an error, or EOFError."""
        return self._error

    def close(self) -> None:
        """End the stream."""
        close = getattr(self._source, "close", None)
        if close is not None:
            close()

    def _run(self, stream: Iterable[EventPacket], ring: SharedRing) -> None:
        writer = PacketWriter(ring, self._source)
        try:
            for packet in stream:
                writer.write(packet)
                self._bell.set()
            writer.finish()
        except BaseException as error:  # raised where the events are used
            self._error = error
        with suppress(ValueError, TypeError):  # its user has given the ring back
            ring.finish()
        self._bell.set()


class ReadingProcess:
    """A process of its own that fills a ring; as :class:`ReadingThread`."""

    def __init__(self, host: Host, ring: SharedRing) -> None:
        self._host, self._ring = host, ring
        self._end: BaseException | None = None

    def over(self) -> bool:
        """Return whether nothing more comes."""
        while self._hear(0.0):
            pass
        return self._end is not None

    def wait(self, seconds: float) -> None:
        """Wait for something new, but not longer."""
        self._hear(seconds)

    def outcome(self) -> BaseException:
        """Return what ended the stream: an error, or EOFError."""
        if not isinstance(self._end, EOFError) or self._ring.finished:
            return self._end or EOFError()
        self._host.wait(END_S)
        return closed_by(self._host, "the events")

    def close(self) -> None:
        """End the stream."""
        self._host.close()

    def _hear(self, seconds: float) -> bool:
        """Take one call of the process that something is new; False where there is none."""
        try:
            return self._end is None and self._host.receive(seconds) is not None
        except Exception as error:  # what ended the stream; its last events are in the ring
            self._end = error
            return False


def fill(asker: Asker, opened: Factory[FileSource], name: str) -> None:
    """Fill a ring of the asker's; the whole work of a reading process."""
    end_in_order()
    ring = SharedRing.attach(name)
    source = opened()
    try:
        tell_size(ring, source.size)
        writer = PacketWriter(ring, source)
        for packet in at_once(source):
            writer.write(packet)
            asker.wake()
        writer.finish()
    finally:
        if isinstance(source, CameraSource):
            source.release()


class EventReader(PacketReader):
    """A stream that is read into a ring, and the first of the ring's users.

    Args:
        ring: That is filled.
        reading: Who fills it.
    """

    def __init__(self, ring: SharedRing, reading: ReadingThread | ReadingProcess) -> None:
        self.ring, self._reading = ring, reading
        self._close_ring = weakref.finalize(self, ring.close)
        while told_size(ring) is None:
            if reading.over():
                raise reading.outcome()
            reading.wait(POLL_S)
        super().__init__(ring)

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
        return cls(ring, ReadingThread(stream, source, ring))

    @classmethod
    def in_process(
        cls,
        opened: Factory[FileSource],
        size: tuple[int, int] | None = None,
    ) -> EventReader:
        """Read a stream in a process of its own.

        Args:
            opened: Opens it there.
            size: Of the packets, ``(width, height)``, px; None waits until the source is open.

        Raises:
            SpikingTacError: It could not be opened.
        """
        ring = SharedRing.create(ROOM_BYTES) if size is None else new_ring(size)
        host = Host(Factory(function=fill, arguments={"opened": opened, "name": ring.name}))
        try:
            return cls(ring, ReadingProcess(host, ring))
        except BaseException:
            host.close()
            raise

    @property
    def ended(self) -> bool:
        """True once nothing more comes."""
        return self._reading.over()

    def take(self, timeout_s: float = 0.0) -> Delivery | None:
        """Return what came next, or None where nothing came in time.

        Raises:
            EOFError: The stream has ended, and everything was taken or missed.
            SpikingTacError: It failed, likewise.
        """
        until_s = time.monotonic() + timeout_s
        while True:
            over = self._reading.over()  # asked first: the last events come before the end
            found = self.next()
            if found is not None:
                return found
            if over:
                self.give_up()
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

    def close(self) -> None:
        """End the stream; what a thread has read by then can still be taken."""
        self._reading.close()

    def release(self) -> None:
        """End the stream, and give the ring back."""
        self._reading.close()
        self._close_ring()
