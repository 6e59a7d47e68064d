"""Who fills a ring with events: a thread of this process, or a process of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any, Protocol

from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import FileSource, Rows
from spikingtac.events.formats.packing import ColumnCheck
from spikingtac.stream.host import Asker, Factory, Host, closed_by
from spikingtac.stream.packets import PacketWriter, tell_size
from spikingtac.stream.ring import SharedRing
from spikingtac.types import EventPacket

# Most packets that a simulation may be ahead of the user it waits for: 0.5 s at 500 steps/s.
AHEAD = 256
LOOK_S = 0.0005  # Time between two looks at a ring that another process fills, s.
END_S = 0.1  # Wait for how a process has ended, s.


def at_once(source: FileSource) -> Iterator[EventPacket]:
    """Yield what came at once: nothing is held back, as a packet for a tracker would be."""
    check = None if source.checked else ColumnCheck(source.size, source.losses)
    for rows in source.columns():
        yield from _packet(rows if check is None else check(*rows), source.size)
    if check is not None:
        yield from _packet(check.finish(), source.size)


def _packet(rows: Rows, size: tuple[int, int]) -> Iterator[EventPacket]:
    x, y, p, t = rows
    if len(t):
        yield EventPacket(x, y, p, t, int(t[0]), int(t[-1]) + 1, size, True)


class Reading(Protocol):
    """Who fills a ring."""

    def over(self) -> bool:
        """Take what it tells besides; return whether nothing more comes."""
        ...

    def wait(self, seconds: float) -> None:
        """Wait for something new, but not longer."""
        ...

    def outcome(self) -> BaseException:
        """Return what ended the stream: an error, or EOFError."""
        ...

    def close(self) -> None:
        """End the stream."""
        ...


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
        """See :class:`Reading`."""
        self._bell.clear()
        return not self._thread.is_alive()

    def wait(self, seconds: float) -> None:
        """See :class:`Reading`."""
        self._bell.wait(seconds)

    def outcome(self) -> BaseException:
        """See :class:`Reading`."""
        return self._error

    def close(self) -> None:
        """See :class:`Reading`."""
        close = getattr(self._source, "close", None)
        if close is not None:
            close()

    def _run(self, stream: Iterable[EventPacket], ring: SharedRing) -> None:
        writer = PacketWriter(ring, self._source)
        try:
            for packet in stream:
                for events, parts in writer.messages(packet):
                    ring.publish(*parts, weight=events)
                self._bell.set()
            writer.finish()
        except BaseException as error:  # raised where the events are used
            self._error = error
        with suppress(ValueError, TypeError):  # its user has given the ring back
            ring.finish()
        self._bell.set()


class ReadingProcess:
    """A process of its own that fills a ring; what it tells besides is taken before its events."""

    def __init__(self, host: Host, ring: SharedRing, take_side_data: Callable[[Any], None]) -> None:
        self._host, self._ring, self._take = host, ring, take_side_data
        self._end: BaseException | None = None

    def over(self) -> bool:
        """See :class:`Reading`."""
        while self._hear(0.0):
            pass
        return self._end is not None

    def wait(self, seconds: float) -> None:
        """See :class:`Reading`."""
        self._hear(min(seconds, LOOK_S))

    def outcome(self) -> BaseException:
        """See :class:`Reading`."""
        if not isinstance(self._end, EOFError) or self._ring.finished:
            return self._end or EOFError()
        self._host.wait(END_S)
        return closed_by(self._host, "the events")

    def close(self) -> None:
        """See :class:`Reading`."""
        self._host.close()

    def _hear(self, seconds: float) -> bool:
        """Take one thing that is told; False where nothing is."""
        if self._end is not None:
            return False
        try:
            told = self._host.receive(seconds)
        except Exception as error:  # what ended the stream; its last events are in the ring
            self._end = error
            return False
        if told is not None:
            self._take(told)
        return told is not None


def fill(asker: Asker, opened: Factory[Any], name: str, waits: bool) -> None:
    """Fill a ring of the asker's; the whole work of a reading process."""
    ring = SharedRing.attach(name)
    ring.write_here()
    if waits:
        _fill_patiently(asker, opened(), ring)
        return
    source = opened()
    try:
        tell_size(ring, source.size)
        writer = PacketWriter(ring, source)
        for packet in at_once(source):
            for events, parts in writer.messages(packet):
                ring.publish(*parts, weight=events)
        writer.finish()
    finally:
        if isinstance(source, CameraSource):
            source.release()


def _fill_patiently(
    asker: Asker, stream: Iterable[tuple[EventPacket, Any]], ring: SharedRing
) -> None:
    writer = PacketWriter(ring, None)
    for packet, side_data in stream:
        asker.tell(side_data)
        for events, parts in writer.messages(packet):
            while not ring.has_room(sum(map(len, parts)), AHEAD):
                time.sleep(LOOK_S)
            ring.publish(*parts, weight=events)
    ring.finish()
