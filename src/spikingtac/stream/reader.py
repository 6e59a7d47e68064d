"""Events that are read at once into a ring, in a thread beside their users.

Whoever is busy leaves no camera unread: the reader goes on, and a user that was too slow is told
how many events it has missed.
"""

import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from spikingtac.events.camera import is_stream
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.events.open import open_events
from spikingtac.stream.packets import Delivery, PacketReader, PacketWriter, at_once, new_ring
from spikingtac.stream.ring import CLOSED, SharedRing
from spikingtac.types import EventPacket, LossCounters

POLL_S = 0.05  # Longest wait of a user before it looks whether it shall end, s.
# Longest wait for a camera beyond the length that was asked for, s: a simulated one may be slower
# than the time that it tells.
SILENT_S = 5.0


class EventReader(PacketReader):
    """A stream that a thread reads into a ring, and the first of the ring's users.

    Args:
        stream: The packets.
        source: Where they come from: its ``size``, ``losses`` and ``triggers``.
        ring: Where they wait for their users; one that is not shared unless given.
        losses: Counters to fill, its own unless given.
    """

    def __init__(
        self,
        stream: Iterable[EventPacket],
        source: Any,
        ring: SharedRing | None = None,
        losses: LossCounters | None = None,
    ) -> None:
        super().__init__(ring or new_ring(source.size), losses)
        self._source, self._bell = source, threading.Event()
        threading.Thread(
            target=self._run, args=(stream,), name="spikingtac-reader", daemon=True
        ).start()

    def __iter__(self) -> Iterator[Delivery]:
        """Yield what comes until the stream ends; see :meth:`take`."""
        with suppress(EOFError):
            while True:
                found = self.take(POLL_S)
                if found is not None:
                    yield found

    def close(self) -> None:
        """End the stream; what was read by then can still be taken."""
        if hasattr(self._source, "close"):
            self._source.close()

    def release(self) -> None:
        """End the stream, and give the ring back."""
        self.close()
        self.ring.close()

    def _wait(self, seconds: float) -> None:
        self._bell.wait(seconds)
        self._bell.clear()

    def _run(self, stream: Iterable[EventPacket]) -> None:
        writer = PacketWriter(self.ring, self._source)
        try:
            for packet in stream:
                writer.write(packet)
                self._bell.set()
            writer.finish()
        except BaseException as error:  # raised where the events are used
            self.error = error
        with suppress(ValueError, TypeError):  # its user has given the ring back
            self.ring.put(CLOSED, 1)
        self._bell.set()


class LiveSource(FileSource):
    """A camera or pipe that is read in a thread beside its user, from the first use on.

    Args:
        source: The camera or pipe.

    Attributes:
        received_s: When the latest events were here, on the monotonic clock, s.
    """

    checked = True

    def __init__(self, source: FileSource) -> None:
        self._source, self._reader = source, None
        super().__init__(source.path, ReadOptions(size=source.size))
        self.received_s = time.monotonic()

    def close(self) -> None:
        """End the iteration soon; what was read is still given out."""
        source: Any = self._source
        source.release() if self._reader is None else source.close()

    def _columns(self) -> Iterator[Rows]:
        # Kept for further iterations: two readers would take each other's events.
        self._reader = self._reader or EventReader(
            at_once(self._source), self._source, losses=self.losses
        )
        for delivery in self._reader:
            self.received_s = delivery.received_s
            self.triggers.extend(delivery.triggers)
            packet = delivery.packet
            yield packet.x, packet.y, packet.p, packet.t


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
    source = opened_camera(path, strict=strict, sensor=sensor)
    return LiveSource(source) if is_stream(Path(path)) else source


def opened_camera(path: str | Path, **options: Any) -> FileSource:
    """Open events; a camera is waited for where it is unplugged. Options as of `open_live`."""
    source = open_events(path, **options)
    if isinstance(source, CameraSource):
        source.when_lost = "reconnect"
    return source


@contextmanager
def no_longer_than(source: object, seconds: float | None) -> Iterator[None]:
    """Close a camera :data:`SILENT_S` after a length of time, if the context lasts so long.

    Lengths count in the camera's own time: one that is silent would be waited for without end.

    Args:
        source: A camera; what has no ``close()``, such as a recording, ends by itself.
        seconds: Length that was asked for, s; None is without end.
    """
    late = threading.Timer((seconds or 0.0) + SILENT_S, getattr(source, "close", lambda: None))
    if seconds is not None:
        late.start()
    try:
        yield
    finally:
        late.cancel()
