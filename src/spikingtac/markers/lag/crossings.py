"""Where a marker's tracked edge stands when the pixels that it passes fire.

The raw material of :mod:`spikingtac.markers.lag.estimate`. A pixel passed by an edge fires a
series of events, one for each step of its log intensity. Of every passage that began with the edge
well on the other side and went on in one direction, the place q of the tracked edge (distance of
the pixel from the disc's rim, negative inside) is collected for each event, apart for the two
polarities, for the event's number in the series and for the edge's speed over the pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.types import EventPacket

# Events of one passage that are told apart: at a contrast of 12 a step of 0.21 makes 12.
ORDERS = 12

# Half-width of the zone around an edge (five logistic scales of a 0.55 px edge).
REACH_PX = 3.0
PLACE_BINS = 120  # Bins of q over the zone: 0.05 px each, a tenth of an edge's width.

# Bins of the edge's speed: below 5 px/s noise moves the edge, above 200 passages are cut short.
SPEED_EDGES_PX_S = np.array([5, 8, 12, 18, 25, 35, 50, 70, 100, 140, 200], np.float64)

# Half of the time over which a velocity is taken: 0.5 px at 100 px/s against jitter of 0.03 px.
SPEED_SPAN_US = 5_000

# Longest passage: 1.5 zones at 30 px/s; a slower edge is not followed to the other side.
LOOK_BACK_US = 300_000
LOOK_STEP_US = 2_000  # Spacing at which a passage is followed back.

# Apparent backward motion that does not end a passage: the jitter of tracked positions.
JITTER_PX = 0.02
_MEMORY = 16


@dataclass(frozen=True, slots=True)
class MarkerTrack:
    """Tracked markers over time.

    Attributes:
        t_us: ``(n,)`` evenly spaced times, us (about 1 ms apart).
        center_px: ``(n, m, 2)`` detected centres, px; NaN where a marker is lost.
        radius_px: ``(m,)`` disc radii, px.
        dark: True for dark markers on light ground.
    """

    t_us: NDArray[np.int64]
    center_px: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    dark: bool = False


@dataclass(frozen=True, slots=True)
class Crossings:
    """Collected places of the tracked edge, as counts.

    Polarity 0 is an edge that brings light (ON), 1 one that takes it away. ``q`` is positive on the
    dark side of the edge, for dark markers too.

    Attributes:
        count: ``(2, ORDERS, speeds, PLACE_BINS)`` events by polarity, number in the series, speed
            bin and bin of q from -REACH_PX to REACH_PX.
        speed_sum_px_s: ``(2, ORDERS, speeds)`` sum of the edge's speeds, px/s.
    """

    count: NDArray[np.int64]
    speed_sum_px_s: NDArray[np.float64]


class _Track(NamedTuple):
    t_us: NDArray[np.int64]
    center_px: NDArray[np.float64]
    velocity_px_s: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    facing: float  # 1 for white markers, -1 for dark ones


class _Pixels(NamedTuple):
    recent_us: NDArray[np.int64]  # (height, width, _MEMORY) times of the running series
    run: NDArray[np.int64]  # (height, width) events of one polarity in a row, signed


class CrossingObserver:
    """Collects :class:`Crossings` from packets of events; how they are cut does not matter.

    Args:
        track: Positions over the whole time of interest.
        size: ``(width, height)`` of the sensor, px.
    """

    def __init__(self, track: MarkerTrack, size: tuple[int, int]) -> None:
        self._track = _prepared(track)
        self._pixels = _Pixels(
            np.zeros((size[1], size[0], _MEMORY), np.int64), np.zeros((size[1], size[0]), np.int64)
        )
        shape = (2, ORDERS, len(SPEED_EDGES_PX_S) - 1)
        self._found = Crossings(np.zeros((*shape, PLACE_BINS), np.int64), np.zeros(shape))

    @property
    def crossings(self) -> Crossings:
        """What has been found so far (a copy)."""
        found = self._found
        return replace(found, count=found.count.copy(), speed_sum_px_s=found.speed_sum_px_s.copy())

    def absorb(self, packet: EventPacket) -> None:
        """Look at further events, in order of time.

        Raises:
            ConfigError: The packet comes from a sensor of another size, or leaves it.
        """
        packet.require_map(self._pixels.run.shape)
        if len(self._track.t_us) < 2:
            return
        found = self._found
        observe_kernel(
            packet.x, packet.y, packet.p, packet.t,
            self._track, self._pixels, found.count, found.speed_sum_px_s,
        )  # fmt: skip


def observe_crossings(packet: EventPacket, track: MarkerTrack) -> Crossings:
    """Return the crossings in one packet; see :class:`CrossingObserver`."""
    observer = CrossingObserver(track, packet.size)
    observer.absorb(packet)
    return observer.crossings


def _prepared(track: MarkerTrack) -> _Track:
    center_px = np.ascontiguousarray(track.center_px, np.float64)
    return _Track(
        np.ascontiguousarray(track.t_us, np.int64),
        center_px,
        velocities(track.t_us, center_px),
        np.ascontiguousarray(track.radius_px, np.float64),
        -1.0 if track.dark else 1.0,
    )


def velocities(t_us: NDArray[np.int64], center_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return central differences over 2 SPEED_SPAN_US, ``(n, m, 2)`` px/s; 0 at both ends."""
    velocity = np.zeros_like(center_px)
    half = _samples(t_us, SPEED_SPAN_US)
    if len(t_us) > 2 * half:
        span_s = (t_us[2 * half :] - t_us[: -2 * half]) * 1e-6
        velocity[half:-half] = (center_px[2 * half :] - center_px[: -2 * half]) / span_s[
            :, None, None
        ]
    return velocity


def _samples(t_us: NDArray[np.int64], span_us: int) -> int:
    if len(t_us) < 2:
        return 1
    return max(1, round(span_us / max(1.0, float(np.median(np.diff(t_us))))))


@njit(cache=True, nogil=True, error_model="numpy")
def edge_kernel(
    track: _Track, row: int, share: float, x: float, y: float
) -> tuple[int, float, float]:
    """Return (marker, q px, dq/dt px/s) of the edge whose zone holds a pixel; marker -1 if none.

    Args:
        track: The prepared track.
        row: Index of the sample before.
        share: Of the way from it to the next sample.
        x: Column, px.
        y: Row, px.
    """
    rest = 1.0 - share
    before, after = track.center_px[row], track.center_px[row + 1]
    for m in range(before.shape[0]):
        outer = track.radius_px[m] + REACH_PX
        dx = x - (rest * before[m, 0] + share * after[m, 0])
        if not abs(dx) <= outer:
            continue
        dy = y - (rest * before[m, 1] + share * after[m, 1])
        rho = np.sqrt(dx * dx + dy * dy)
        q = (rho - track.radius_px[m]) * track.facing
        if abs(q) <= REACH_PX and rho > 1.0:
            v = track.velocity_px_s
            vx = rest * v[row, m, 0] + share * v[row + 1, m, 0]
            vy = rest * v[row, m, 1] + share * v[row + 1, m, 1]
            return m, q, -(vx * dx + vy * dy) / rho * track.facing
    return -1, 0.0, 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def entry_kernel(track: _Track, row: int, marker: int, x: float, y: float, from_side: float) -> int:
    """Return the sample at which an edge was still a zone away, or -1 for no clean passage.

    Args:
        track: The prepared track.
        row: Index of the sample before the event.
        marker: Whose edge.
        x: Column, px.
        y: Row, px.
        from_side: 1 if the pixel was on the dark side, -1 if on the bright one.
    """
    spacing_us = track.t_us[1] - track.t_us[0]
    stride = max(1, LOOK_STEP_US // max(1, spacing_us))
    last = -REACH_PX
    while row >= 0:
        dx, dy = x - track.center_px[row, marker, 0], y - track.center_px[row, marker, 1]
        q = (np.sqrt(dx * dx + dy * dy) - track.radius_px[marker]) * track.facing * from_side
        if q > REACH_PX:
            return row
        if not q >= last - JITTER_PX:
            return -1
        last = q
        row -= stride
    return -1


# np.searchsorted does the same and takes 0.5 s to compile.
@njit(cache=True)
def last_row_kernel(increasing: NDArray[Any], value: Any) -> int:
    """Return the index of the last element that is at most the value; -1 if none is."""
    low, high = 0, len(increasing)
    while low < high:
        middle = (low + high) // 2
        if increasing[middle] <= value:
            low = middle + 1
        else:
            high = middle
    return low - 1


@njit(cache=True, nogil=True, error_model="numpy")
def observe_kernel(
    x: NDArray[np.uint16], y: NDArray[np.uint16], p: NDArray[np.bool_], t: NDArray[np.int64],
    track: _Track, pixels: _Pixels, count: NDArray[np.int64], speed_sum: NDArray[np.float64],
) -> None:  # fmt: skip
    """Count events into ``count`` and ``speed_sum``; see :class:`Crossings`."""
    t_us, row, edges = track.t_us, 0, SPEED_EDGES_PX_S
    for i in range(len(t)):
        on = 1.0 if p[i] else -1.0
        run = pixels.run[y[i], x[i]]
        run = abs(run) if run * on > 0 else 0
        pixels.recent_us[y[i], x[i], run % _MEMORY] = t[i]
        pixels.run[y[i], x[i]] = (run + 1) * on
        if t[i] < t_us[0] or t[i] >= t_us[-1]:
            continue
        if t_us[row + 1] <= t[i] or t_us[row] > t[i]:
            row = last_row_kernel(t_us, t[i])
        share = (t[i] - t_us[row]) / (t_us[row + 1] - t_us[row])
        marker, q, rate = edge_kernel(track, row, share, float(x[i]), float(y[i]))
        # Only an edge that brings what the event reports: light moves out of q > 0 to q < 0.
        speed = -rate * on
        if marker < 0 or not (edges[0] <= speed < edges[-1]):
            continue
        entry = entry_kernel(track, row, marker, float(x[i]), float(y[i]), on)
        if entry < 0 or t_us[row] - t_us[entry] > LOOK_BACK_US:
            continue
        order = -1
        for n in range(min(run + 1, _MEMORY)):
            order += pixels.recent_us[y[i], x[i], n] >= t_us[entry]
        if order < ORDERS:
            side, speeds = 0 if p[i] else 1, last_row_kernel(edges, speed)
            place = min(int((q + REACH_PX) / (2.0 * REACH_PX) * PLACE_BINS), PLACE_BINS - 1)
            count[side, order, speeds, place] += 1
            speed_sum[side, order, speeds] += speed
