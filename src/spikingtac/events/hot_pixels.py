"""Hot pixels: they send events whatever the light does, so that no event of theirs tells anything.

Every sensor has some, at 10 Hz to some kHz. One that lies beside a marker outweighs its rim: the
counts of a calibration were wrong by up to five times, and a marker strayed by 7 px (simulated).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.kernels import kernel
from spikingtac.types import US_PER_S, EventPacket

# Window by which quiet stretches are found: long enough for some noise events on 320x320 px.
WINDOW_US = 10_000

# Fraction of the windows, those with the fewest events, that counts as noise alone (a
# sensor that is touched rests for more of its time than this).
QUIET_SHARE = 0.1

# A pixel is hot beyond so many standard deviations of the noise of the others (roots of its mean)
# and so many events: where a pixel has less than one on average, chance goes beyond any number.
HOT_DEVIATIONS, HOT_EVENTS = 6.0, 5

# Parts of the quiet events, one after the other; in how many of them a hot pixel sends more than
# this share of its average. (A pixel on a resting rim may flicker while the marker stays.)
QUARTERS, FEWEST_QUARTERS, EVEN_SHARE = 4, 3, 0.25

# A hot pixel sends so many times what the second busiest of its eight neighbours does. (A rim that
# moves makes several pixels busy; two hot pixels may touch.)
OVER_NEIGHBOURS = 4.0
WATCH_US = 500_000  # Window of the watch for pixels that become hot later, us of data time.
# A new hot pixel sends so many events in every window, 40 Hz (rims at rest are silent).
WATCH_EVENTS = 20

# Windows in which it is busy and its neighbours are not, 2 s. One in which they move is no
# evidence either way; one in which it is silent begins anew.
WATCH_WINDOWS = 4

# How far around it every pixel sends :data:`OVER_NEIGHBOURS` times less, px. (The end of a thin arc
# that a vibration keeps busy has one busy neighbour. So two that touch are not found.)
NEAR_PX = 2
# Mark of a hot pixel among the counted windows; events that are counted in one, 510 Hz.
HOT, MOST_COUNTED = 255, 255

# Of each pixel, its events in this window, and in how many windows it was busy alone.
WATCHED = np.dtype([("events", np.uint8), ("alone", np.uint8)])


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
    limit = np.inf
    for _ in range(2):  # the most events of usual noise; found twice, since hot pixels raise it
        usual = counts[counts <= limit]
        mean = float(usual.mean()) if len(usual) else 0.0
        limit = mean + HOT_DEVIATIONS * mean**0.5 + HOT_EVENTS
    parts = [np.bincount(part, minlength=len(counts)) for part in np.array_split(pixel, QUARTERS)]
    steady = (np.array(parts) > EVEN_SHARE / QUARTERS * counts).sum(axis=0) >= FEWEST_QUARTERS
    candidates = np.flatnonzero((counts > limit) & steady)
    rows, columns = np.divmod(candidates, width)
    framed = np.pad(counts.reshape(height, width), 1)
    around = np.array([framed[rows + k // 3, columns + k % 3] for k in range(9) if k != 4])
    alone = counts[candidates] > OVER_NEIGHBOURS * np.sort(around, axis=0)[-2]
    return np.column_stack([columns, rows])[alone].astype(np.int64)


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
        keep = ~self._hot[packet.y, packet.x]
        return packet if keep.all() else packet.select(keep)


class HotPixelWatch:
    """Drops the events of hot pixels, of the known ones and of those that become hot meanwhile.

    A pixel that sends steadily while its neighbours are silent moves with no marker. Decisions are
    made at fixed data times, so the packing of a stream does not matter.

    Args:
        hot_px: ``(h, 2)`` columns and rows of the known hot pixels, or None.
        size: ``(width, height)`` of the sensor, px.
        pixels: ``(height, width)`` records with the fields of :data:`WATCHED` to count in.

    Attributes:
        pixels: Those records.
        found: How many pixels became hot.
    """

    def __init__(
        self,
        hot_px: NDArray[np.int64] | None,
        size: tuple[int, int],
        pixels: NDArray[np.void] | None = None,
    ) -> None:
        self.pixels = np.empty(size[::-1], WATCHED) if pixels is None else pixels
        self.pixels["events"] = self.pixels["alone"] = 0
        if hot_px is not None:
            self.pixels["alone"][hot_mask(hot_px, size)] = HOT
        self._until_us = int(np.iinfo(np.int64).min)
        self.found = 0

    @property
    def hot(self) -> NDArray[np.bool_]:
        """``(height, width)`` which pixels are hot by now, the known ones included."""
        return self.pixels["alone"] == HOT

    def parts(self, packet: EventPacket) -> Iterator[EventPacket]:
        """Yield the events window by window; judge each window that has ended.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        packet.require_map(self.pixels.shape)
        while len(packet) and packet.t_end_us > self._until_us:
            before, packet = packet.split(self._until_us)
            yield before
            if len(packet):
                self._begin_window(int(packet.t[0]))
        if len(packet):
            yield packet

    def kept(self, packet: EventPacket) -> EventPacket:
        """Return the packet without the events of hot pixels; itself if there is none.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        keep, first = np.empty(len(packet), np.bool_), 0
        for part in self.parts(packet):
            _watch_kernel(self.pixels, part.x, part.y, keep[first : first + len(part)])
            first += len(part)
        return packet if keep.all() else packet.select(keep)

    def _begin_window(self, t_us: int) -> None:
        self.found += _judge_window(self.pixels)
        if t_us - WATCH_US >= self._until_us:  # a whole window without any event
            _judge_window(self.pixels)
        self._until_us = (t_us // WATCH_US + 1) * WATCH_US


@kernel()
def _watch_kernel(
    pixels: Any, x: NDArray[Any], y: NDArray[Any], keep: NDArray[np.bool_]
) -> None:  # pragma: no cover - compiled
    """Count the events; fill in which to keep."""
    for i in range(len(x)):
        keep[i] = heard_kernel(pixels[y[i], x[i]])


@kernel(forceinline=True)
def heard_kernel(pixel: Any) -> bool:  # pragma: no cover - compiled
    """Return whether an event's pixel is not hot, and count the event."""
    pixel.events += pixel.events < MOST_COUNTED
    return pixel.alone != HOT


@kernel()
def _judge_window(pixels: Any) -> int:  # pragma: no cover - compiled
    """Count the window where a pixel was busy alone, and begin a new one; return how many are new.

    They are hot from now on.
    """
    found = 0
    height, width = pixels.shape
    for row in range(height):
        for column in range(width):
            pixel = pixels[row, column]
            if pixel.alone == HOT:
                continue
            if pixel.events < WATCH_EVENTS:
                pixel.alone = 0
                continue
            busy = 0  # pixels nearby that send as much, itself among them
            for near_row in range(max(row - NEAR_PX, 0), min(row + NEAR_PX + 1, height)):
                for near in range(max(column - NEAR_PX, 0), min(column + NEAR_PX + 1, width)):
                    busy += OVER_NEIGHBOURS * pixels[near_row, near].events >= pixel.events
            if busy == 1:
                pixel.alone += 1
                if pixel.alone == WATCH_WINDOWS:
                    pixel.alone = HOT
                    found += 1
    for row in range(height):
        for column in range(width):
            pixels[row, column].events = 0
    return found


# Beginning of a recording in which hot pixels are looked for, us (one at 10 Hz sends 300
# events meanwhile).
HOT_PIXEL_US = 30_000_000


@dataclass(frozen=True, slots=True)
class EventQuality:
    """Figures of a stretch of events.

    Attributes:
        on_fraction: Fraction of ON events; None without events.
        noise_hz: Events per pixel and second in the quietest windows, hot pixels left out.
        hot_px: ``(h, 2)`` columns and rows of hot pixels.
    """

    on_fraction: float | None
    noise_hz: float
    hot_px: NDArray[np.int64]


def judge_events(events: EventPacket) -> EventQuality:
    """Return the figures of a stretch of events.

    Noise is judged in the quietest tenth of the windows of 10 ms; a sensor that never rests
    therefore shows more noise than it has.
    """
    quiet, quiet_us = quiet_events(events.t, events.t_start_us, events.t_end_us)
    width, height = events.size
    pixel = events.y[quiet].astype(np.int64) * width + events.x[quiet]
    hot_px = find_hot_pixels(pixel, events.size)
    hot = hot_mask(hot_px, events.size).ravel()[pixel]
    usual = width * height - len(hot_px)
    return EventQuality(
        on_fraction=float(events.p.mean()) if len(events) else None,
        noise_hz=np.count_nonzero(~hot) * US_PER_S / quiet_us / usual if usual else 0.0,
        hot_px=hot_px,
    )


def hot_pixels_of(packets: Iterable[EventPacket]) -> NDArray[np.int64]:
    """Return ``(h, 2)`` columns and rows of the hot pixels of a recording, from its beginning.

    Args:
        packets: The recording; it is iterated twice.
    """
    end_us = next((packet.t_start_us for packet in packets), 0) + HOT_PIXEL_US
    early = list(takewhile(lambda packet: packet.t_start_us < end_us, packets))
    if not early:
        return np.empty((0, 2), int)
    whole = EventPacket.concatenate(early)  # the last one may leap by years
    return judge_events(whole.split(min(end_us, whole.t_end_us))[0]).hot_px
