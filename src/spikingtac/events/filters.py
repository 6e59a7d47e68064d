"""Filters on events: stateful ones give the same events however the stream is cut into packets."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.types import EventPacket

# How long an event supports its neighbours, us (ours: an edge at 1 px/ms passes a neighbour
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
        x, y = np.empty_like(packet.x), np.empty_like(packet.y)
        p, t = np.empty_like(packet.p), np.empty_like(packet.t)
        events = packet.x, packet.y, packet.p, packet.t
        count = supported_kernel(*events, self._window_us, self._last_us, (x, y, p, t))
        kept = x[:count], y[:count], p[:count], t[:count]
        span_us = packet.t_start_us, packet.t_end_us
        return EventPacket(*kept, *span_us, packet.size, checked=True)


class RandomDrop:
    """Drops each event with one and the same probability, for experiments.

    Args:
        share: Probability of a drop, 0 to 1.
        seed: Seed of the generator; the same events are dropped however the stream is cut.

    Raises:
        ConfigError: The share is not between 0 and 1.
    """

    def __init__(self, share: float, seed: int) -> None:
        if not 0 <= share <= 1:
            raise ConfigError(f"share is {share}, it must lie between 0 and 1")
        self._share = share
        self._random = np.random.default_rng(seed)

    def __call__(self, packet: EventPacket) -> EventPacket:
        """Return the events of a packet that stay."""
        return packet.select(self._random.random(len(packet)) >= self._share)


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
