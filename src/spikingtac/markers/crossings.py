"""Position of a marker's tracked edge at the events of the pixels that it crosses.

These are the data of :mod:`spikingtac.markers.lag`. A pixel crossed by an edge fires a series of
events, one for each step of its log intensity. A crossing counts if it begins with the edge well on
the other side and keeps one direction. At each of its events the position q of the tracked edge is
recorded: the distance of the pixel from the disc's rim, negative inside. The data are histograms by
polarity, number of the event in the series, and speed of the edge over the pixel. A rung is one
polarity and one number.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.state_map.graded import Array
from spikingtac.types import EventPacket

ORDERS = 12  # Most recorded events of one crossing: at contrast 12 a step of 0.21 makes 12.

# Half-width of the zone around an edge (five logistic scales of a 0.55 px edge).
REACH_PX = 3.0
PLACE_BINS = 120  # Bins of q over the zone: 0.05 px each, a tenth of an edge's width.

# Bins of the edge's speed: below 5 px/s noise dominates its motion, above 100 px/s the lag of a
# pixel in px grows less than proportionally.
SPEED_EDGES_PX_S = np.array([5, 8, 12, 18, 25, 35, 50, 70, 100], np.float64)

PERIOD_US = 1_000  # Time between tracked positions: at 100 px/s an edge moves by 0.1 px.

# Half of the time over which a velocity is taken: 0.5 px at 100 px/s, with jitter of 0.03 px.
SPEED_SPAN_US = 5_000

# Longest crossing: 1.5 zones at 30 px/s; slower ones are left out.
LOOK_BACK_US = 300_000
LOOK_STEP_US = 2_000  # Time step in which a crossing is traced back, us.

JITTER_PX = 0.02  # Backward motion that does not end a crossing: jitter of tracked positions.
_MEMORY = 16  # Events of a running series that a pixel remembers.


class MarkerTrack(NamedTuple):
    """Tracked markers over time; :func:`marker_track` makes it.

    Attributes:
        t_us: ``(n,)`` times, us, PERIOD_US apart.
        center_px: ``(n, m, 2)`` detected centres, px; NaN where a marker is lost.
        velocity_px_s: ``(n, m, 2)`` central differences over 2 SPEED_SPAN_US; 0 at both ends.
        radius_px: ``(m,)`` disc radii, px.
        facing: 1 for white markers on dark ground, -1 for dark ones.
    """

    t_us: NDArray[np.int64]
    center_px: NDArray[np.float64]
    velocity_px_s: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    facing: float


@dataclass(frozen=True, slots=True)
class Crossings:
    """Histograms of the tracked edge's position q at events.

    Polarity 0 is an edge that brightens the pixel (ON), 1 an edge that darkens it. ``q`` is
    positive on the dark side of the edge, for dark markers too.

    Attributes:
        count: ``(2, ORDERS, speeds, PLACE_BINS)`` events by polarity, number in the series, speed
            bin and bin of q from -REACH_PX to REACH_PX.
        speed_sum_px_s: ``(2, ORDERS, speeds)`` sum of the edge's speeds, px/s.
    """

    count: NDArray[np.int64]
    speed_sum_px_s: NDArray[np.float64]


def marker_track(
    t_us: NDArray[np.int64],
    center_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    dark: bool = False,
) -> MarkerTrack:
    """Return a track with its velocities; the arguments are its attributes."""
    velocity = np.zeros(center_px.shape)
    half = SPEED_SPAN_US // PERIOD_US
    if len(t_us) > 2 * half:
        span_s = (t_us[2 * half :] - t_us[: -2 * half]) * 1e-6
        moved_px = center_px[2 * half :] - center_px[: -2 * half]
        velocity[half:-half] = moved_px / span_s[:, np.newaxis, np.newaxis]
    center_px = np.ascontiguousarray(center_px, np.float64)
    facing = -1.0 if dark else 1.0
    return MarkerTrack(t_us, center_px, velocity, radius_px.astype(np.float64), facing)


def observe_crossings(
    packets: Iterable[EventPacket], track: MarkerTrack, size: tuple[int, int]
) -> Crossings:
    """Return the crossings in a recording, for any division into packets.

    Args:
        packets: Events in order of time.
        track: Positions over the whole time of interest.
        size: ``(width, height)`` of the sensor, px.

    Raises:
        ConfigError: A packet comes from a sensor of another size, or leaves it.
    """
    runs = np.zeros((size[1], size[0]), np.int64)
    recent_us = np.zeros((*runs.shape, _MEMORY), np.int64)
    shape = 2, ORDERS, len(SPEED_EDGES_PX_S) - 1
    found = Crossings(np.zeros((*shape, PLACE_BINS), np.int64), np.zeros(shape))
    for packet in packets if len(track.t_us) > 1 else ():
        packet.require_map(runs.shape)
        rows = np.searchsorted(track.t_us, packet.t, side="right") - 1
        columns = packet.x, packet.y, packet.p, packet.t, rows
        observe_kernel(*columns, track, recent_us, runs, found.count, found.speed_sum_px_s)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def edge_kernel(
    track: MarkerTrack, row: int, share: float, x: float, y: float
) -> tuple[int, float, float]:
    """Return (marker, q px, dq/dt px/s) of the edge whose zone holds a pixel; marker -1 if none.

    ``row`` is the sample before, ``share`` the fraction of the time from it to the next one.
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
def entry_kernel(
    track: MarkerTrack, row: int, marker: int, x: float, y: float, from_side: float
) -> int:
    """Return the last sample at which an edge was outside of its zone, or -1 for no clean crossing.

    ``row`` is the sample before the event, ``from_side`` 1 if the pixel was on the dark side.
    """
    last = -REACH_PX
    while row >= 0:
        dx, dy = x - track.center_px[row, marker, 0], y - track.center_px[row, marker, 1]
        q = (np.sqrt(dx * dx + dy * dy) - track.radius_px[marker]) * track.facing * from_side
        if q > REACH_PX:
            return row
        if not q >= last - JITTER_PX:
            return -1
        last = q
        row -= LOOK_STEP_US // PERIOD_US
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def observe_kernel(
    x: Array, y: Array, p: Array, t: Array, rows: Array, track: MarkerTrack, recent_us: Array,
    runs: Array, count: Array, speed_sum: Array,
) -> None:  # fmt: skip
    """Count events into ``count`` and ``speed_sum``; see :class:`Crossings`.

    ``rows`` are the samples of the track before the events, -1 for none. ``recent_us`` is
    ``(height, width, _MEMORY)`` times of each pixel's running series, and ``runs`` tells how many
    events of one polarity came in a row, signed.
    """
    t_us, edges = track.t_us, SPEED_EDGES_PX_S
    for i in range(len(t)):
        on = 1 if p[i] else -1
        run = max(runs[y[i], x[i]] * on, 0)
        recent_us[y[i], x[i], run % _MEMORY] = t[i]
        runs[y[i], x[i]] = (run + 1) * on
        row = rows[i]
        if row < 0 or row + 1 >= len(t_us):
            continue
        share = (t[i] - t_us[row]) / (t_us[row + 1] - t_us[row])
        marker, q, rate = edge_kernel(track, row, share, float(x[i]), float(y[i]))
        # Only edges with the event's polarity: q decreases while the pixel brightens.
        speed = -rate * on
        if marker < 0 or not (edges[0] <= speed < edges[-1]):
            continue
        entry = entry_kernel(track, row, marker, float(x[i]), float(y[i]), on)
        if entry < 0 or t_us[row] - t_us[entry] > LOOK_BACK_US:
            continue
        order = -1
        for n in range(min(run + 1, _MEMORY)):
            order += recent_us[y[i], x[i], n] >= t_us[entry]
        if order < ORDERS:
            side, speeds = 0 if p[i] else 1, 0
            while edges[speeds + 1] <= speed:
                speeds += 1
            place = min(int((q + REACH_PX) / (2.0 * REACH_PX) * PLACE_BINS), PLACE_BINS - 1)
            count[side, order, speeds, place] += 1
            speed_sum[side, order, speeds] += speed
