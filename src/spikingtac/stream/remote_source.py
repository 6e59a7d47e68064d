"""A source that runs in a process of its own, a bounded stretch ahead of its reader.

A simulated sensor costs about as much as a tracker; side by side in one process they would share an
interpreter lock and neither would keep up. A camera is read there at once, however busy its reader.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from spikingtac.errors import CalibrationError, RecordingError
from spikingtac.events.cameras.source import CameraSource
from spikingtac.events.open import open_events
from spikingtac.stream.host import Asker, Factory, Host, closed_by
from spikingtac.types import EventPacket, LossCounters

ITEMS_AHEAD = 256
"""Packets that wait to be read: 0.5 s of a simulation that steps at 500 Hz."""
POLL_S = 0.1

Stream = Iterable[tuple[EventPacket, Any]]
"""Packets, each with side data that belong to it (or None)."""


class RemoteSource:
    """An :class:`~spikingtac.events.source.EventSource` whose packets come from another process.

    Args:
        open_stream: Opens the stream, in the other process.
        size: Size of the packets, ``(width, height)``, px; where it is None, the stream begins with
            a packet that tells it, and is not passed on.
        take_side_data: Called with each packet's side data before the packet is yielded.
        inherit: As of :class:`~spikingtac.stream.host.Host`.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        losses: Nothing is lost between the processes; losses of the stream are in its side data.

    Raises:
        RecordingError: The stream ended before it told its size.
        SpikingTacError: It could not be opened, where its size was not known.
    """

    def __init__(
        self,
        open_stream: Factory[Stream],
        size: tuple[int, int] | None,
        take_side_data: Callable[[Any], None] = lambda _: None,
        *,
        inherit: bool = False,
    ) -> None:
        self.losses = LossCounters()
        self._take_side_data = take_side_data
        pour = Factory(function=_pour, arguments={"open_stream": open_stream})
        self._host = Host(pour, inherit=inherit)
        self.size = size or self._told_size()

    @classmethod
    def of_camera(cls, path: str, size: tuple[int, int] | None) -> RemoteSource:
        """Return a camera that a process of its own reads; one that is unplugged is waited for.

        Args:
            path: Named pipe or address.
            size: ``(width, height)`` that the calibration is for, px; None takes any.

        Raises:
            SpikingTacError: There is no such camera, where its size was not known.
        """
        losses = LossCounters()
        opened: Factory[Stream] = Factory(
            function=camera_packets, arguments={"path": path, "size": size}
        )
        source = cls(opened, size, losses.update)
        source.losses = losses
        return source

    def __iter__(self) -> Iterator[EventPacket]:
        while (item := self._next()) is not None:
            packet, side_data = item
            self._take_side_data(side_data)
            yield packet

    def close(self) -> None:
        """Stop the other process."""
        self._host.close()

    def _told_size(self) -> tuple[int, int]:
        try:
            item = self._next()
            if item is None:
                raise RecordingError("the stream ended before it began; start its writer first")
        except BaseException:
            self.close()
            raise
        return item[0].size

    def _next(self) -> Any:
        """Return the next packet with its side data, or None at the stream's end."""
        while True:
            try:
                item = self._host.receive(POLL_S)
            except EOFError as error:
                self._host.wait(POLL_S)
                raise closed_by(self._host, "the events") from error
            if item is not None:
                return item or None


def camera_packets(
    path: str, size: tuple[int, int] | None
) -> Iterator[tuple[EventPacket, dict[str, int]]]:
    """Yield a camera's packets as they come, each with what was lost or mended so far.

    Args:
        path: Named pipe or address.
        size: ``(width, height)`` that the calibration is for, px; None takes any, and yields
            an empty packet first, which tells the size before the camera sends anything.

    Raises:
        CalibrationError: The camera has another size than its calibration.
    """
    source = open_events(path)
    if isinstance(source, CameraSource):
        source.when_lost = "reconnect"
    if size is not None and tuple(source.size) != tuple(size):
        raise CalibrationError(
            f"the calibration is for {size[0]}x{size[1]}, the camera is "
            f"{source.size[0]}x{source.size[1]}; calibrate this sensor"
        )
    try:
        if size is None:
            yield EventPacket.empty(0, 0, source.size), {}
        for packet in source:
            yield packet, dict(source.losses.kinds())
    finally:
        if isinstance(source, CameraSource):
            source.release()


def _pour(asker: Asker, open_stream: Factory[Stream]) -> None:
    """Send a stream, from a thread that waits for the reader: the stream itself does not."""
    waiting: queue.Queue[Any] = queue.Queue(ITEMS_AHEAD)

    def send() -> None:
        while (item := waiting.get()) is not None:
            asker.tell(item)

    sending = threading.Thread(target=send, daemon=True)
    sending.start()
    try:
        for item in open_stream():
            waiting.put(item)
        waiting.put(())
    finally:
        waiting.put(None)
        sending.join()
