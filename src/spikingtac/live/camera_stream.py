"""A camera's packets with their losses, for a process that does nothing else than to read it."""

from __future__ import annotations

from collections.abc import Iterator

from spikingtac.errors import CalibrationError
from spikingtac.events.cameras.source import CameraSource
from spikingtac.events.open import open_events
from spikingtac.types import EventPacket


def stream_packets(
    path: str, size: tuple[int, int] | None
) -> Iterator[tuple[EventPacket, dict[str, int]]]:
    """Yield a camera's packets as they come, each with what was lost or mended so far.

    A camera that is unplugged is waited for.

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
