"""Sources of events that are read beside their user: a simulation, a camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from spikingtac.errors import CalibrationError
from spikingtac.events.address import Address, is_address, is_stream
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows
from spikingtac.events.open import open_events
from spikingtac.stream.host import Factory
from spikingtac.stream.reader import EventReader, new_ring
from spikingtac.stream.reading import at_once
from spikingtac.types import EventPacket, LossCounters


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
        self._reader = EventReader.in_process(opened, size, take_side_data, inherit=inherit)

    def __iter__(self) -> Iterator[EventPacket]:
        for delivery in self._reader:
            yield delivery.packet

    def close(self) -> None:
        """Stop the other process."""
        self._reader.release()


class LiveSource(FileSource):
    """A camera or pipe that is read beside its user.

    Args:
        source: What is read in a thread, from the first use on.
        options: As of the source.
        reader: What is read already instead, in another process.

    Attributes:
        own: The source that the thread reads; None where another process reads it.
        reader: What reads, once it does.
        received_s: When the latest events were here, on the monotonic clock, s.
    """

    checked = True

    def __init__(
        self, source: FileSource | None, options: ReadOptions, reader: EventReader | None = None
    ) -> None:
        self.own, self.reader = source, reader
        super().__init__(Path("camera") if source is None else source.path, options)
        if source is not None:
            self.format, self.notes = source.format, list(source.notes)
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
        share = Address.parse(path).text("share") if is_address(path) else ""
        reader = EventReader.in_process(opened, size, share=share)
        return cls(None, ReadOptions(), reader)

    def start(self) -> EventReader:
        """Begin to read; further calls do nothing."""
        if self.reader is None:
            own = self.own
            assert own is not None
            share = own.address.text("share") if isinstance(own, CameraSource) else ""
            ring = new_ring(own.size, share=share)
            self.reader = EventReader.in_thread(at_once(own), own, ring)
        return self.reader

    def close(self) -> None:
        """End the iteration soon; what was read is still given out."""
        if self.reader is not None:
            self.reader.close()
        elif isinstance(self.own, CameraSource):
            self.own.close()

    def _size(self) -> tuple[int, int]:
        of = self.own or self.reader
        assert of is not None
        return of.size

    def _columns(self) -> Iterator[Rows]:
        reader = self.start()
        for delivery in reader:
            self.losses.update(reader.losses)
            self.received_s = delivery.received_s
            self.progress = 0.0 if self.own is None else self.own.progress
            if delivery.triggers is not None:
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
    return LiveSource(source, ReadOptions(strict=strict)) if is_stream(Path(path)) else source


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
