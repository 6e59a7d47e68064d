"""Hot pixels: they send events whatever the light does, so that no event of theirs tells anything.

Every sensor has some, at 10 Hz to some kHz. One that lies beside a marker outweighs its rim: the
counts of a calibration were wrong by up to five times, and a marker strayed by 7 px (simulated).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.types import EventPacket

WINDOW_US = 10_000
"""Window by which quiet stretches are found: long enough for some noise events on 320x320 px."""
QUIET_SHARE = 0.1
"""Fraction of the windows, those with the fewest events, that counts as noise alone (ours: a sensor
that is touched rests for more of its time than this)."""
HOT_DEVIATIONS, HOT_EVENTS = 6.0, 5
"""A pixel is hot beyond so many standard deviations of the noise of the others and so many events
(ours). Noise is Poisson distributed, its standard deviation the root of its mean; where a pixel has
less than one event on the average, chance goes beyond any number of deviations."""
QUARTERS, FEWEST_QUARTERS, EVEN_SHARE = 4, 3, 0.25
"""Parts of the quiet events, one after the other; in how many of them a hot pixel sends more than
this share of what it sends on the average. (A pixel on a resting rim may flicker for as long as the
marker stays.)"""
OVER_NEIGHBOURS = 4.0
"""A hot pixel sends so many times what the second busiest of its eight neighbours does. (A rim that
moves even in the quietest windows makes several pixels busy; two hot pixels may touch.)"""


def quiet_events(
    t_us: NDArray[np.integer], t_start_us: int, t_end_us: int
) -> tuple[NDArray[np.intp], int]:
    """Return which events lie in the quietest windows of a stretch of time.

    Args:
        t_us: ``(n,)`` times in order, us.
        t_start_us: Begin of the stretch.
        t_end_us: Its end.

    Returns:
        Their indices in order of time, and the length of all these windows, us.
    """
    duration_us = max(t_end_us - t_start_us, 1)
    windows = max(duration_us // WINDOW_US, 1)
    edges_us = t_start_us + WINDOW_US * np.arange(1, windows, dtype=np.int64)
    first = [0, *np.searchsorted(t_us, edges_us.astype(t_us.dtype)).tolist(), len(t_us)]
    quietest = np.argsort(np.diff(first), kind="stable")[: max(round(QUIET_SHARE * windows), 1)]
    parts = [np.arange(first[window], first[window + 1]) for window in sorted(quietest.tolist())]
    return np.concatenate(parts), len(parts) * min(WINDOW_US, duration_us)


def find_hot_pixels(pixel: NDArray[np.integer], size: tuple[int, int]) -> NDArray[np.int64]:
    """Return ``(h, 2)`` columns and rows of the hot pixels.

    Args:
        pixel: ``(n,)`` row times width plus column of each event of the quiet windows, in order of
            time.
        size: ``(width, height)`` of the sensor, px.
    """
    width, height = size
    counts = np.bincount(pixel, minlength=width * height)
    candidates = np.flatnonzero(counts > _limit(counts))
    candidates = candidates[_steady(pixel, counts, candidates)]
    rows, columns = np.divmod(candidates, width)
    framed = np.pad(counts.reshape(height, width), 1)
    around = np.array(
        [
            framed[rows + row, columns + column]
            for row in range(3)
            for column in range(3)
            if (row, column) != (1, 1)
        ]
    )
    alone = counts[candidates] > OVER_NEIGHBOURS * np.sort(around, axis=0)[-2]
    return np.column_stack([columns, rows])[alone].astype(np.int64)


def _steady(
    pixel: NDArray[np.integer], counts: NDArray[np.int64], candidates: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return which candidates send all the time, and not for a while."""
    parts = [np.bincount(part, minlength=len(counts)) for part in np.array_split(pixel, QUARTERS)]
    even = EVEN_SHARE / QUARTERS * counts[candidates]
    return np.sum([part[candidates] > even for part in parts], axis=0) >= FEWEST_QUARTERS


def _limit(counts: NDArray[np.int64]) -> float:
    """Return the most events of a pixel of usual noise; found twice, since hot ones raise it."""
    limit = np.inf
    for _ in range(2):
        usual = counts[counts <= limit]
        mean = float(usual.mean()) if len(usual) else 0.0
        limit = mean + HOT_DEVIATIONS * mean**0.5 + HOT_EVENTS
    return limit


def hot_mask(hot_px: NDArray[np.int64], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return ``(height, width)`` which pixels are hot, from their ``(h, 2)`` columns and rows."""
    hot = np.zeros(size[::-1], np.bool_)
    hot[hot_px[:, 1], hot_px[:, 0]] = True
    return hot


class HotPixelFilter:
    """Drops the events of known hot pixels.

    Args:
        hot_px: ``(h, 2)`` columns and rows of the hot pixels; None or none at all keeps everything.
        size: ``(width, height)`` of the sensor, px.
    """

    def __init__(self, hot_px: NDArray[np.int64] | None, size: tuple[int, int]) -> None:
        self._hot = hot_mask(hot_px, size) if hot_px is not None and len(hot_px) else None

    def kept(self, packet: EventPacket) -> EventPacket:
        """Return the packet without the events of hot pixels; itself if there is none.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        if self._hot is None or not len(packet):
            return packet
        packet.require_map(self._hot.shape)
        keep = np.empty(len(packet), np.bool_)
        return packet.select(keep) if mark_kernel(self._hot, packet.x, packet.y, keep) else packet


@njit(cache=True, nogil=True)
def mark_kernel(
    hot: NDArray[np.bool_], x: NDArray[np.uint16], y: NDArray[np.uint16], keep: NDArray[np.bool_]
) -> int:
    """Mark the events to keep; return how many are to be dropped."""
    dropped = 0
    for i in range(len(x)):
        keep[i] = not hot[y[i], x[i]]
        dropped += not keep[i]
    return dropped
