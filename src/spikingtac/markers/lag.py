"""Lag of tracked markers behind the true motion, estimated from events alone.

A constant delay leaves no trace. A photoreceptor's delay does: it is inversely proportional to the
light, so that the dark levels of an edge come later than the bright ones, on leading and trailing
edges alike. Let an edge pass a pixel at speed v, and let its n-th event come when the tracked edge
is q beyond the pixel, along the motion. Then

    q = a_n + v tau(level_n) - v lag +- v skew,    tau = tau_white (1 + B) / (I + B)

with a_n the place at rest of this rung (polarity and number), level_n the edge's profile at a_n,
I = contrast^(level - 1) the light relative to white, and B the dark current (or veiling light) in
the same unit. This is a pixel that is a first-order low-pass in log intensity whose corner grows
with the light (Hu, Liu, Delbruck 2021, doi:10.1109/CVPRW53098.2021.00144), to first order in
v tau. The spread of the levels gives tau_white, the common part the lag of the positions. The skew,
of opposite sign for the two polarities, takes up leak and dead time and is discarded. So the mean
places are linear in the a_n, lag, skew, and tau_white.

An edge hardly shows B: it is a prior, and its spread is part of the uncertainty. What does not
depend on light at all (a bus, a driver's clock) stays unseen and has to be measured otherwise.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import EventSource
from spikingtac.events.windows import windows
from spikingtac.markers.graded.tracker import GradedTracker, GradedTrackerConfig
from spikingtac.state_map.graded import Array
from spikingtac.types import EventPacket, FloatArray, MarkerFrame

# Dark current B, relative to white: between none and v2e's offset of 20 at a white of 170, 0.12.
# What these two make of the lag differs from it by this share (0.08 to 0.1 on three recordings).
DARK, DARK_SHARE = 0.06, 0.09

# Events that a mean place needs, and bins of speed that a rung needs.
LEAST_COUNT, FEWEST_SPEEDS = 60, 3

# Below the lower level noise fires as often as the edge; rungs above the other one belong to the
# pixels with the smallest steps only.
LOWEST_LEVEL, HIGHEST_LEVEL = 0.12, 0.93

# Places further from a bin's median are noise events: three times the spread of an edge's own, px.
TRIM_PX = 1.0

# Uncertainty of a mean place by what the model leaves out (curved edges, mismatch between
# pixels), px (from noise-free recordings).
FLOOR_PX = 0.004

FLOOR_US = 100.0  # Uncertainty of the lag by what the model leaves out, us.

# A measurement that is no better is not used, us: lags are 500 us in good light, 2500 us in dim.
LARGEST_ERROR_US = 1_000.0

LEAST_RUNGS = 2  # Rungs of each polarity without which level and skew cannot be told apart.

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


def slide_lag_us(source: EventSource, calibration: Calibration) -> float | None:
    """Return the lag of a recording of slides, us, or None where it cannot be seen.

    The recording is tracked without any lag correction.

    Args:
        source: The slides; read twice.
        calibration: What the slides taught so far.
    """
    if calibration.contrast is None or calibration.edge_px is None:
        return None
    track = edge_track(followed(windows(source, PERIOD_US), calibration), calibration)
    edge = DiscProfile(calibration.contrast, calibration.edge_px)
    estimate = estimate_lag(crossings(source, track, source.size), edge)
    return None if estimate is None else estimate[0]


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


def estimate_lag(found: Crossings, edge: DiscProfile) -> tuple[float, float] | None:
    """Return the lag of positions and its standard deviation, us; None where it cannot be seen.

    Args:
        found: The crossings of the tracked positions.
        edge: The calibrated edge.
    """
    count, speed_px_s = found
    enough = count.sum(axis=3) >= LEAST_COUNT
    enough &= enough.sum(axis=2, keepdims=True) >= FEWEST_SPEEDS
    side, order, fast = np.nonzero(enough)
    place_px, error_px = trimmed_means(count[enough].astype(np.float64))
    facing, moved_px_s = 2.0 * side - 1.0, speed_px_s[fast]
    weight = 1.0 / np.hypot(error_px, FLOOR_PX)
    rungs, rung = np.unique(side * ORDERS + order, return_inverse=True)
    own = [rung == one for one in range(len(rungs))]  # each rung has a place at rest of its own
    rest_px = [np.polyfit(moved_px_s[k], place_px[k], 1, w=weight[k])[1] for k in own]
    level = edge.level(np.array(rest_px))[rung]
    told = (level > LOWEST_LEVEL) & (level < HIGHEST_LEVEL)
    if min(len(np.unique(rung[told & (side == one)])) for one in (0, 1)) < LEAST_RUNGS:
        return None
    parts = moved_px_s * [-np.ones(len(level)), facing, slowness(edge, level, DARK)]
    design = (weight * [*parts, *own])[:, told].T
    along = (weight * facing * place_px)[told]
    solved, _, rank, _ = np.linalg.lstsq(design, along, rcond=None)
    misfit = ((along - design @ solved) ** 2).sum()
    scale = max(1.0, misfit / (len(along) - rank))
    spread_us = 1e6 * np.sqrt(scale * np.linalg.pinv(design.T @ design)[0, 0])
    lag_us = 1e6 * float(solved[0])
    error_us = float(np.sqrt(spread_us**2 + (DARK_SHARE * lag_us) ** 2 + FLOOR_US**2))
    possible = error_us < LARGEST_ERROR_US and lag_us > -error_us  # no edge comes before its light
    return (max(lag_us, 0.0), error_us) if possible else None


def trimmed_means(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ``(n,)`` means within TRIM_PX of the median, and their errors, px.

    ``counts`` is ``(n, PLACE_BINS)`` events by place; no row is empty.
    """
    width_px = 2.0 * REACH_PX / PLACE_BINS
    place_px = -REACH_PX + (np.arange(PLACE_BINS) + 0.5) * width_px
    half = 0.5 * counts.sum(axis=1, keepdims=True)
    median_px = place_px[np.argmax(np.cumsum(counts, axis=1) >= half, axis=1)]
    near = counts * (np.abs(place_px - median_px[:, None]) < TRIM_PX)
    total = near.sum(axis=1)
    mean_px = near @ place_px / total
    variance_px2 = (near * (place_px - mean_px[:, None]) ** 2).sum(axis=1) / total
    return mean_px, np.sqrt(variance_px2 / total)


def slowness(edge: DiscProfile, level: FloatArray, dark: float) -> FloatArray:
    """Return tau over tau_white at a level, (1 + B) / (I + B)."""
    return (1.0 + dark) / (edge.contrast ** (level - 1.0) + dark)
