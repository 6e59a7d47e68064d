"""Crossings of the markers' edges over pixels: where the tracked edge is at each event of a pixel.

The delays of the events (:mod:`spikingtac.markers.lag`) are estimated from them.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.tracker import GradedTracker, GradedTrackerConfig
from spikingtac.state_map.graded import Array
from spikingtac.types import EventPacket, FloatArray, MarkerFrame

# So many markers' edges tell the lag of a larger skin: each event is compared with all of them.
MOST_MARKERS = 128

ORDERS = 12  # Most events of one crossing: at contrast 12 a step of 0.21 makes 12.

# Half-width of the zone around an edge (five logistic scales of a 0.55 px edge).
REACH_PX = 3.0
PLACE_BINS = 120  # Bins of q over the zone: 0.05 px each, a tenth of an edge's width.

# Bins of the edge's speed: below 5 px/s noise dominates its motion, above 100 px/s the lag of a
# pixel in px grows less than proportionally.
SPEED_EDGES_PX_S = np.array([5, 8, 12, 18, 25, 35, 50, 70, 100], np.float64)

PERIOD_US = 1_000  # Time between tracked positions: at 100 px/s an edge moves by 0.1 px.

# Half of the time over which a speed is taken, in tracked positions: 0.5 px at 100 px/s, with
# jitter of 0.03 px.
SPEED_SPAN = 5

# Longest crossing, and the time step in which it is traced back, in tracked positions: 1.5 zones
# at 30 px/s; slower ones are left out.
LOOK_BACK, LOOK_STEP = 300, 2

JITTER_PX = 0.02  # Backward motion that does not end a crossing: jitter of tracked positions.


Crossings = tuple[NDArray[np.int64], FloatArray]  # What :func:`crossings` returns.


class MarkerTrack(NamedTuple):
    """Tracked markers over time.

    Attributes:
        t_us: ``(n,)`` times, us, PERIOD_US apart.
        center_px: ``(n, m, 2)`` detected centres, px; NaN where a marker is lost.
        radius_px: ``(m,)`` disc radii, px.
        facing: 1 for white markers on dark ground, -1 for dark ones.
    """

    t_us: NDArray[np.int64]
    center_px: FloatArray
    radius_px: FloatArray
    facing: float


def followed(packets: Iterable[EventPacket], known: Calibration) -> Iterator[MarkerFrame]:
    """Yield the markers at the end of each packet, by a tracker without lag correction."""
    tracker = GradedTracker(GradedTrackerConfig(backlash=0.0), replace(known, lag_us=0.0))
    for packet in packets:
        tracker.absorb(packet)
        yield tracker.estimate(packet.t_end_us)


def edge_track(frames: Iterable[MarkerFrame], calibration: Calibration) -> MarkerTrack:
    """Return where the edges of markers are that were followed."""
    radius_px = calibration.radius_px
    chosen = np.unique(np.linspace(0, len(radius_px) - 1, MOST_MARKERS).astype(np.int64))
    t_us, center_px = [], []
    for frame in frames:
        held = frame.coasted[chosen, np.newaxis]
        center_px.append(np.where(held, np.nan, frame.detected_px[chosen]))
        t_us.append(frame.t_us)
    places = np.array(center_px).reshape(len(t_us), len(chosen), 2)
    facing = -1.0 if calibration.polarity == "dark" else 1.0
    return MarkerTrack(np.array(t_us, np.int64), places, radius_px[chosen], facing)


def crossings(
    packets: Iterable[EventPacket], track: MarkerTrack, size: tuple[int, int]
) -> Crossings:
    """Return histograms of the tracked edge's position q at the events of clean crossings.

    A pixel crossed by an edge fires a series of events, one for each step of its log intensity. A
    crossing counts if it begins with the edge well on the other side and keeps one direction. At
    each of its events the position q of the tracked edge is the distance of the pixel from the
    disc's rim, positive on the dark side of the edge, for dark markers too.

    Args:
        packets: Events in order of time, in any division.
        track: Positions over the whole time of interest.
        size: ``(width, height)`` of the sensor, px.

    Returns:
        ``(2, ORDERS, speeds, PLACE_BINS)`` events by polarity (0 brightens the pixel, 1 darkens
        it), number in the series, speed of the edge, and q from -REACH_PX to REACH_PX;
        ``(speeds,)`` the mean speed of each bin, px/s.

    Raises:
        ConfigError: A packet comes from a sensor of another size, or leaves it.
    """
    runs = np.zeros((size[1], size[0]), np.int64)
    last_us, speed_sum = np.zeros_like(runs), np.zeros(len(SPEED_EDGES_PX_S) - 1)
    count = np.zeros((2, ORDERS, len(speed_sum), PLACE_BINS), np.int64)
    for packet in packets:
        packet.require_map(runs.shape)
        rows = np.searchsorted(track.t_us, packet.t, side="right") - 1
        events = packet.x, packet.y, packet.p, packet.t, rows
        crossings_kernel(events, track, (runs, last_us), (count, speed_sum))
    return count, speed_sum / np.maximum(count.sum(axis=(0, 1, 3)), 1)


@njit(cache=True, nogil=True)
def place_kernel(track: MarkerTrack, row: int, m: int, x: float, y: float) -> float:
    """Return the position q of a marker's edge at a pixel, px, at one of the tracked times."""
    dx, dy = x - track.center_px[row, m, 0], y - track.center_px[row, m, 1]
    return (np.sqrt(dx * dx + dy * dy) - track.radius_px[m]) * track.facing


@njit(cache=True, nogil=True)
def crosses_kernel(track: MarkerTrack, row: int, m: int, x: float, y: float, side: float) -> bool:
    """Return whether an edge came from the other side of its zone without turning back.

    ``row`` is the sample before the event, ``side`` 1 if the pixel was on the dark side.
    """
    last = -REACH_PX
    for before in range(row, max(row - LOOK_BACK, 0) - 1, -LOOK_STEP):
        q = place_kernel(track, before, m, x, y) * side
        if q > REACH_PX or not q >= last - JITTER_PX:
            return q > REACH_PX
        last = q
    return False


@njit(cache=True, nogil=True)
def crossings_kernel(
    events: tuple[Array, Array, Array, Array, Array],
    track: MarkerTrack,
    pixels: tuple[Array, Array],
    found: tuple[Array, Array],
) -> None:
    """Count events into the histograms of :func:`crossings`, and add up the speeds of each bin.

    ``events`` holds columns, rows, polarities, times, and the samples of the track before them;
    ``pixels`` how many events of one polarity came in a row at each pixel, signed, and the time of
    its last event, us.
    """
    columns, lines, polarities, times_us, rows = events
    (count, speed_sum), (runs, last_us) = found, pixels
    t_us, edges, bins = track.t_us, SPEED_EDGES_PX_S, count.shape[3]
    for i in range(len(rows)):
        x, y, t, row, on = columns[i], lines[i], times_us[i], rows[i], 1 if polarities[i] else -1
        order = max(runs[y, x] * on, 0) if t - last_us[y, x] <= LOOK_BACK * PERIOD_US else 0
        runs[y, x], last_us[y, x] = (order + 1) * on, t
        if order >= ORDERS or row < SPEED_SPAN or row + SPEED_SPAN >= len(t_us):
            continue
        share = (t - t_us[row]) / (t_us[row + 1] - t_us[row])
        for m in range(len(track.radius_px)):
            q = (1.0 - share) * place_kernel(track, row, m, x, y)
            q += share * place_kernel(track, row + 1, m, x, y)
            if not abs(q) <= REACH_PX:
                continue
            # Only edges with the event's polarity: q decreases while the pixel brightens.
            after = place_kernel(track, row + SPEED_SPAN, m, x, y)
            moved = (place_kernel(track, row - SPEED_SPAN, m, x, y) - after) * on
            speed = moved / (t_us[row + SPEED_SPAN] - t_us[row - SPEED_SPAN]) * 1e6
            if edges[0] <= speed < edges[-1] and crosses_kernel(track, row, m, x, y, on):
                place = min(int((q + REACH_PX) / (2.0 * REACH_PX) * bins), bins - 1)
                fast = np.searchsorted(edges, speed, side="right") - 1
                count[(1 - on) // 2, order, fast, place] += 1
                speed_sum[fast] += speed
            break
