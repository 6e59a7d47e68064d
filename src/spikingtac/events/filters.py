"""Filters on events, and changes to a whole recording: part of it, another orientation or clock.

Filters with a state give the same events however the stream is cut into packets. Coordinates follow
the package's convention: the origin is the centre of the top left pixel, y points down.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.events.formats.codec import Triggers
from spikingtac.types import EventPacket

# How long an event supports its neighbours, us (an edge at 1 px/ms passes a neighbour
# within 1 ms; 5 ms leaves room for slow motion).
SUPPORT_US = 5_000


class BackgroundActivityFilter:
    """Keeps events that one of the eight neighbours supports by an event shortly before.

    Source: T. Delbruck, "Frame-free dynamic digital vision", Intl. Symp. on Secure-Life
    Electronics, 2008 (the background activity filter).

    Args:
        size: ``(width, height)`` of the sensor, px.
        window_us: How long an event supports its neighbours, us.
    """

    def __init__(self, size: tuple[int, int], window_us: int = SUPPORT_US) -> None:
        if window_us < 1:
            raise ValueError(f"window_us is {window_us}, it must be at least 1")
        self._window_us = window_us
        self._last_us = np.full((size[1] + 2, size[0] + 2), np.iinfo(np.int64).min // 2)

    def __call__(self, packet: EventPacket) -> EventPacket:
        """Return the supported events of a packet that follows the ones before.

        Raises:
            ConfigError: The packet comes from a sensor of another size, or leaves it.
        """
        height, width = self._last_us.shape
        packet.require_map((height - 2, width - 2))
        events = packet.x, packet.y, packet.p, packet.t
        x, y = np.empty_like(packet.x), np.empty_like(packet.y)
        p, t = np.empty_like(packet.p), np.empty_like(packet.t)
        count = supported_kernel(*events, self._window_us, self._last_us, (x, y, p, t))
        kept = EventPacket(x, y, p, t, packet.t_start_us, packet.t_end_us, packet.size, True)
        return kept.part(0, count, packet.t_start_us, packet.t_end_us)


ONE, TWO = np.uint64(1), np.uint64(2)  # Unsigned, so that no index can be meant from the end.


@njit(cache=True, nogil=True)
def supported_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    t: NDArray[np.int64],
    window_us: int,
    last_us: NDArray[np.int64],
    kept: tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_], NDArray[np.int64]],
) -> int:
    """Copy the events that a neighbour fired before within the window; return how many.

    Args:
        x: Columns, px.
        y: Rows, px.
        p: Polarities.
        t: Times, us, in order.
        window_us: Length of the window.
        last_us: ``(height + 2, width + 2)`` time of each pixel's last event; updated.
        kept: Where to write their columns, rows, polarities and times; as long as ``x``.
    """
    kept_x, kept_y, kept_p, kept_t = kept
    count = 0
    for i in range(len(t)):
        row, column = np.uint64(y[i]), np.uint64(x[i])
        # All eight are looked at: no processor can foresee which of them fired, and a wrong guess
        # costs more than the look. So does writing only what is kept.
        newest = max(last_us[row, column], last_us[row, column + ONE])
        newest = max(newest, last_us[row, column + TWO])
        newest = max(newest, last_us[row + ONE, column], last_us[row + ONE, column + TWO])
        newest = max(newest, last_us[row + TWO, column], last_us[row + TWO, column + ONE])
        newest = max(newest, last_us[row + TWO, column + TWO])
        kept_x[count], kept_y[count], kept_p[count], kept_t[count] = x[i], y[i], p[i], t[i]
        count += newest >= t[i] - window_us
        last_us[row + ONE, column + ONE] = t[i]
    return count


MOST_SHIFT_US = 1 << 53  # Largest shift: 285 years, so that no time leaves 64 bits.


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
        from_us, to_us = self.from_us, self.to_us
        if from_us is not None and to_us is not None and from_us >= to_us:
            raise ConfigError(f"the interval from {from_us} to {to_us} us is empty")
        for packet in packets:
            start = packet.t_start_us if from_us is None else max(packet.t_start_us, from_us)
            end = packet.t_end_us if to_us is None else min(packet.t_end_us, to_us)
            if to_us is not None and packet.t_start_us >= to_us:
                return
            if start < end:
                first, last = np.searchsorted(packet.t, (start, end))
                yield self._changed(packet.part(int(first), int(last), start, end))

    def triggers(self, triggers: Triggers) -> Triggers:
        """Return the trigger edges within the part of the time, on the changed clock."""
        begin_us = -np.inf if self.from_us is None else self.from_us
        end_us = np.inf if self.to_us is None else self.to_us
        kept = triggers.select((triggers.t_us >= begin_us) & (triggers.t_us < end_us))
        kept.rows["t_us"] += self.shift_us
        return kept

    def _changed(self, packet: EventPacket) -> EventPacket:
        width, height = packet.size
        if abs(self.shift_us) > MOST_SHIFT_US:
            raise ConfigError(f"shift_us is {self.shift_us}, valid are +-{MOST_SHIFT_US} us")
        if self.shift_us:
            packet = replace(
                packet,
                t=packet.t + self.shift_us,
                t_start_us=packet.t_start_us + self.shift_us,
                t_end_us=packet.t_end_us + self.shift_us,
            )
        if self.flip_polarity:
            packet = replace(packet, p=~packet.p)
        if self.crop_px is not None:
            packet = self._cropped(packet, self.crop_px)
            width, height = packet.size
        if self.flip not in (None, "x", "y"):
            raise ConfigError(f"flip {self.flip!r} is unknown (valid: x, y)")
        if self.rotate_deg not in (0, 90, 180, 270):
            raise ConfigError(f"rotate {self.rotate_deg} is not possible (valid: 90, 180, 270)")
        # A turn by 90 degrees is a mirrored picture of which rows and columns change places.
        if (self.flip == "x") != (self.rotate_deg in (180, 270)):
            packet = replace(packet, x=np.uint16(width - 1) - packet.x)
        if (self.flip == "y") != (self.rotate_deg in (90, 180)):
            packet = replace(packet, y=np.uint16(height - 1) - packet.y)
        if self.rotate_deg in (90, 270):
            packet = replace(packet, x=packet.y, y=packet.x, size=(height, width))
        return packet

    @staticmethod
    def _cropped(packet: EventPacket, box_px: tuple[int, int, int, int]) -> EventPacket:
        """Keep the events of a rectangle, whose corner becomes the origin."""
        (x0, y0, x1, y1), (width, height) = box_px, packet.size
        if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
            raise ConfigError(
                f"crop {x0} {y0} {x1} {y1} does not lie on the sensor of {width}x{height} px "
                "(valid: 0 <= x0 < x1 <= width, 0 <= y0 < y1 <= height)"
            )
        inside = (packet.x >= x0) & (packet.x < x1) & (packet.y >= y0) & (packet.y < y1)
        kept = packet.select(inside)
        x, y = kept.x - np.uint16(x0), kept.y - np.uint16(y0)
        return replace(kept, x=x, y=y, size=(x1 - x0, y1 - y0))
