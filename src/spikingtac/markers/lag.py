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

After each event a pixel is blind for a dead time D, in which it misses a change of its level. So an
edge is farther at the n-th event, by v D (S'_1 + ... + S'_n-1) / S'_n with S'_k the slope of the
edge at the k-th. But fast edges have fewer events, and the pixels with the largest thresholds drop
out of the later rungs. So not means are compared here, but where a fixed share of all edges that
began to cross has fired.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import EventSource
from spikingtac.events.windows import windows
from spikingtac.markers.crossings import (
    ORDERS,
    PERIOD_US,
    PLACE_BINS,
    REACH_PX,
    Crossings,
    crossings,
    edge_track,
    followed,
)
from spikingtac.markers.graded.appearance import DEAD_US, dead_time_of
from spikingtac.types import FloatArray

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

# A measurement that is no better is not used, us, or as a share of the lag: lags are 500 us in good
# light, 2500 us in dim light, and more than 10 ms in the dark.
LARGEST_ERROR_US, LARGEST_ERROR_SHARE = 1_000.0, 0.3

# Rungs of each polarity that tell level and skew apart; with two nothing would contradict them.
# (Three simulated sensors without a lag, of two OFF events per swing, gave 8 to 12 ms.)
LEAST_RUNGS = 3

# Share of the edges that began to cross, at whose place the dead time is measured. (Ten simulated
# sensors of 200 to 1,000 us give 75 to 125 % of it; twelve of 0 or 100 us -160 to 225, one 350 us.)
FIRST_SHARE = 0.2

# A dead time is used where it exceeds the usual one by two standard errors. The largest one, and
# the largest standard error, us: recovering pixels give any. (With their own of 500 us four
# simulated sensors err by a third less.)
LARGEST_DEAD_US, LARGEST_DEAD_ERROR_US = 5_000.0, 100.0

# Share of the shift by the dead time that mean places show (0.74 to 0.85 for 200 to 1,000 us). What
# a usual one shifts is left in the lag.
MEAN_SHARE = 0.8

# Polarity, number in the series, and speed, px/s, of each of some cells of the histograms.
Cells = tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]


def with_delays(source: EventSource, calibration: Calibration) -> Calibration:
    """Return a calibration with the lag, and with the dead time where it is unusually long.

    The recording is tracked without any lag correction; a delay that cannot be seen is None.

    Args:
        source: What taught the calibration; read twice, or four times.
        calibration: What it taught so far.
    """
    if calibration.contrast is None or calibration.edge_px is None:
        return calibration
    edge = DiscProfile(calibration.contrast, calibration.edge_px)
    found = _crossings(source, calibration)
    dead_time_us = estimate_dead_time(found, edge)
    if dead_time_us is not None:
        calibration = replace(calibration, dead_time_us=dead_time_us)
        found = _crossings(source, calibration)
    lag = estimate_lag(found, edge, dead_time_of(calibration))
    return calibration if lag is None else replace(calibration, lag_us=lag[0])


def _crossings(source: EventSource, calibration: Calibration) -> Crossings:
    track = edge_track(followed(windows(source, PERIOD_US), calibration), calibration)
    return crossings(source, track, source.size)


def estimate_lag(
    found: Crossings, edge: DiscProfile, dead_time_us: float = DEAD_US
) -> tuple[float, float] | None:
    """Return the lag of positions and its standard deviation, us; None where it cannot be seen.

    Args:
        found: The crossings of the tracked positions.
        edge: The calibrated edge.
        dead_time_us: Dead time of the pixels, us.
    """
    count, speeds_px_s = found
    enough, cells = _frequent(count.sum(axis=3) >= LEAST_COUNT, speeds_px_s)
    side, order, speed_px_s = cells
    place_px, error_px = trimmed_means(count[enough].astype(np.float64))
    late_s = 1e-6 * MEAN_SHARE * (dead_time_us - DEAD_US) * order
    place_px -= (2.0 * side - 1.0) * late_s * speed_px_s
    solved = _delay_us(cells, (place_px, error_px), edge)
    if solved is None:
        return None
    lag_us, spread_us = solved
    error_us = float(np.sqrt(spread_us**2 + (DARK_SHARE * lag_us) ** 2 + FLOOR_US**2))
    told = error_us < max(LARGEST_ERROR_US, LARGEST_ERROR_SHARE * lag_us)
    # No edge comes before its light.
    return (max(lag_us, 0.0), error_us) if told and lag_us > -error_us else None


def estimate_dead_time(found: Crossings, edge: DiscProfile) -> float | None:
    """Return the dead time of the pixels, us; None where it is not clearly longer than usual.

    Args:
        found: The crossings of the tracked positions.
        edge: The calibrated edge.
    """
    count, speeds_px_s = found
    events = count.sum(axis=3)
    target = np.broadcast_to(FIRST_SHARE * np.maximum(events[:, :1], 1.0), events.shape)
    enough, cells = _frequent((events >= LEAST_COUNT) & (events > target), speeds_px_s)
    places = _quantiles(count[enough], cells[0], target[enough])
    solved = _delay_us(cells, places, edge, dead=True)
    if solved is None:
        return None
    dead_us, error_us = solved
    clear = error_us < LARGEST_DEAD_ERROR_US and dead_us - 2.0 * error_us > DEAD_US
    return dead_us if clear and dead_us < LARGEST_DEAD_US else None


def _frequent(
    enough: NDArray[np.bool_], speeds_px_s: FloatArray
) -> tuple[NDArray[np.bool_], Cells]:
    """Return which cells belong to a rung that enough speeds tell, and these cells."""
    frequent = enough & (enough.sum(axis=2, keepdims=True) >= FEWEST_SPEEDS)
    side, order, fast = np.nonzero(frequent)
    return frequent, (side, order, speeds_px_s[fast])


def _delay_us(
    cells: Cells, places: tuple[FloatArray, FloatArray], edge: DiscProfile, *, dead: bool = False
) -> tuple[float, float] | None:
    """Solve for lag, skew and tau_white; return the lag and its standard error, us.

    With ``dead`` the dead time is solved for, too, and returned instead of the lag.
    ``places`` are those of the cells, px, with their errors. None where too few rungs tell a level.
    """
    (side, order, speed_px_s), (place_px, error_px) = cells, places
    facing, weight = 2.0 * side - 1.0, 1.0 / np.hypot(error_px, FLOOR_PX)
    rungs, rung = np.unique(side * ORDERS + order, return_inverse=True)
    own = [rung == one for one in range(len(rungs))]  # each rung has a place at rest of its own
    rest_px = np.array([np.polyfit(speed_px_s[k], place_px[k], 1, w=weight[k])[1] for k in own])
    level = edge.level(rest_px)[rung]
    told = (level > LOWEST_LEVEL) & (level < HIGHEST_LEVEL)
    if min(len(np.unique(rung[told & (side == one)])) for one in (0, 1)) < LEAST_RUNGS:
        return None
    parts = [-np.ones(len(level)), facing, slowness(edge, level, DARK)]
    if dead:
        steep = -edge.slope(rest_px)
        before = (rungs // ORDERS == rungs[:, None] // ORDERS) & (rungs < rungs[:, None])
        parts.insert(0, (before @ steep / steep)[rung])
    design = (weight * [*(speed_px_s * parts), *own])[:, told].T
    along = (weight * facing * place_px)[told]
    solved, _, rank, _ = np.linalg.lstsq(design, along, rcond=None)
    misfit = ((along - design @ solved) ** 2).sum()
    scale = max(1.0, misfit / (len(along) - rank))
    variance = scale * max(float(np.linalg.pinv(design.T @ design)[0, 0]), 0.0)
    return 1e6 * float(solved[0]), 1e6 * float(np.sqrt(variance))


def _quantiles(
    counts: NDArray[np.int64], side: NDArray[np.intp], target: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``(n,)`` places at which so many events of a rung have come, and their errors, px."""
    width_px, row = 2.0 * REACH_PX / PLACE_BINS, np.arange(len(target))
    ahead = np.where(side[:, None] == 0, counts[:, ::-1], counts)  # in the order of their coming
    come = np.pad(np.cumsum(ahead, axis=1), ((0, 0), (1, 0)))
    after = (come >= target[:, None]).argmax(axis=1)
    passed = after - (come[row, after] - target) / (come[row, after] - come[row, after - 1])
    place_px = (2.0 * side - 1.0) * (passed * width_px - REACH_PX)
    near = come[row, np.minimum(after + 1, PLACE_BINS)] - come[row, np.maximum(after - 2, 0)]
    per_px = near / (3.0 * width_px)
    return place_px, np.sqrt((1.0 - FIRST_SHARE) * target) / per_px


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
