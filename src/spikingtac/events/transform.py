"""Changes to a whole recording: part of its time, of its sensor, another orientation or clock.

Each function takes a packet and returns another; none keeps a state, so the cutting of a stream
into packets does not matter. Coordinates follow the package's convention: the origin is the centre
of the top left pixel, y points down.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.events.formats.codec import Triggers
from spikingtac.types import EventPacket

# Angle, degrees -> quarter turns, clockwise as the picture is seen.
QUARTER_TURNS = {90: 1, 180: 2, 270: 3}


def time_slice(
    packets: Iterable[EventPacket], from_us: int | None = None, to_us: int | None = None
) -> Iterator[EventPacket]:
    """Keep the events in ``[from_us, to_us)``; None keeps the stream's own end on that side.

    Raises:
        ConfigError: The interval is empty.
    """
    if from_us is not None and to_us is not None and from_us >= to_us:
        raise ConfigError(f"the interval from {from_us} to {to_us} us is empty")
    for packet in packets:
        start = packet.t_start_us if from_us is None else max(packet.t_start_us, from_us)
        end = packet.t_end_us if to_us is None else min(packet.t_end_us, to_us)
        if to_us is not None and packet.t_start_us >= to_us:
            return
        if start < end:
            first, last = np.searchsorted(packet.t, (start, end))
            yield packet.part(int(first), int(last), start, end)


def flip_polarity(packet: EventPacket) -> EventPacket:
    """Exchange ON and OFF: dark markers on light ground then read as white ones on dark."""
    return replace(packet, p=~packet.p)


def shift(packet: EventPacket, shift_us: int) -> EventPacket:
    """Add to all times, us."""
    start_us, end_us = packet.t_start_us + shift_us, packet.t_end_us + shift_us
    return replace(packet, t=packet.t + shift_us, t_start_us=start_us, t_end_us=end_us)


def crop(packet: EventPacket, box_px: tuple[int, int, int, int]) -> EventPacket:
    """Keep the events of a rectangle, whose corner becomes the origin.

    Args:
        packet: Events.
        box_px: ``(x0, y0, x1, y1)``: first column and row, and those after the last.

    Raises:
        ConfigError: The rectangle is empty, or does not lie on the sensor.
    """
    x0, y0, x1, y1 = box_px
    size = cropped_size(packet.size, box_px)
    inside = (packet.x >= x0) & (packet.x < x1) & (packet.y >= y0) & (packet.y < y1)
    kept = packet.select(inside)
    x, y = kept.x - np.uint16(x0), kept.y - np.uint16(y0)
    return replace(kept, x=x, y=y, size=size)


def cropped_size(size: tuple[int, int], box_px: tuple[int, int, int, int]) -> tuple[int, int]:
    """Return the size of a rectangle ``(x0, y0, x1, y1)`` of a sensor, px.

    Raises:
        ConfigError: The rectangle is empty, or does not lie on the sensor.
    """
    x0, y0, x1, y1 = box_px
    if not (0 <= x0 < x1 <= size[0] and 0 <= y0 < y1 <= size[1]):
        raise ConfigError(
            f"crop {x0} {y0} {x1} {y1} does not lie on the sensor of {size[0]}x{size[1]} px "
            "(valid: 0 <= x0 < x1 <= width, 0 <= y0 < y1 <= height)"
        )
    return x1 - x0, y1 - y0


def flip(packet: EventPacket, axis: Literal["x", "y"]) -> EventPacket:
    """Mirror the sensor: ``x`` exchanges left and right, ``y`` top and bottom.

    Raises:
        ConfigError: There is no such axis.
    """
    width, height = packet.size
    if axis == "x":
        return replace(packet, x=_mirrored(packet.x, width))
    if axis == "y":
        return replace(packet, y=_mirrored(packet.y, height))
    raise ConfigError(f"flip {axis!r} is unknown (valid: x, y)")


def rotate(packet: EventPacket, angle_deg: int) -> EventPacket:
    """Turn the picture clockwise by 90, 180 or 270 degrees.

    Raises:
        ConfigError: It is another angle.
    """
    if angle_deg not in QUARTER_TURNS:
        raise ConfigError(f"rotate {angle_deg} is not possible (valid: 90, 180, 270)")
    width, height = packet.size
    if angle_deg == 90:
        return replace(packet, x=_mirrored(packet.y, height), y=packet.x, size=(height, width))
    if angle_deg == 180:
        return replace(packet, x=_mirrored(packet.x, width), y=_mirrored(packet.y, height))
    return replace(packet, x=packet.y, y=_mirrored(packet.x, width), size=(height, width))


def _mirrored(column: NDArray[np.uint16], length: int) -> NDArray[np.uint16]:
    return (length - 1 - column.astype(np.int64)).astype(np.uint16)


@dataclass(frozen=True, kw_only=True)
class Transform:
    """Changes in a fixed order: time, polarity, crop, flip, rotation.

    Attributes:
        from_us: First microsecond to keep, or None.
        to_us: First microsecond after the part to keep, or None.
        shift_us: Added to all times after that, us.
        flip_polarity: Whether ON and OFF are exchanged.
        crop_px: ``(x0, y0, x1, y1)`` of the rectangle to keep, or None.
        flip: Axis that is mirrored, ``x`` or ``y``, or None.
        rotate_deg: Angle of a turn clockwise: 0, 90, 180 or 270.
    """

    from_us: int | None = None
    to_us: int | None = None
    shift_us: int = 0
    flip_polarity: bool = False
    crop_px: tuple[int, int, int, int] | None = None
    flip: Literal["x", "y"] | None = None
    rotate_deg: int = 0

    def size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the size that a sensor of a given size becomes, px.

        Raises:
            ConfigError: A change is not possible on such a sensor.
        """
        return self._changed(EventPacket.empty(0, 1, size)).size

    def packets(self, packets: Iterable[EventPacket]) -> Iterator[EventPacket]:
        """Yield the changed packets.

        Raises:
            ConfigError: A change is not possible on such a sensor, or the interval is empty.
        """
        for packet in time_slice(packets, self.from_us, self.to_us):
            yield self._changed(packet)

    def triggers(self, triggers: Triggers) -> Triggers:
        """Return the trigger edges within the part of the time, on the changed clock."""
        t_us = triggers.t_us
        keep = np.ones(len(t_us), np.bool_)
        if self.from_us is not None:
            keep &= t_us >= self.from_us
        if self.to_us is not None:
            keep &= t_us < self.to_us
        kept = Triggers()
        kept.append(t_us[keep] + self.shift_us, triggers.channel[keep], triggers.edge[keep])
        return kept

    def _changed(self, packet: EventPacket) -> EventPacket:
        if self.shift_us:
            packet = shift(packet, self.shift_us)
        if self.flip_polarity:
            packet = flip_polarity(packet)
        if self.crop_px is not None:
            packet = crop(packet, self.crop_px)
        if self.flip is not None:
            packet = flip(packet, self.flip)
        if self.rotate_deg:
            packet = rotate(packet, self.rotate_deg)
        return packet
