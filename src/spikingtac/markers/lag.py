"""How far tracked markers are behind the true motion, from events alone.

A constant delay leaves no trace. A photoreceptor's delay does: it is inversely proportional to the
light, so that the dark levels of an edge come later than the bright ones, on leading and trailing
edges alike. Let an edge pass a pixel at speed v, and let its n-th event come when the tracked edge
is q beyond the pixel, along the motion. Then

    q = a_n + overshoot(level_n, v tau_white) - v lag +- v skew

with a_n the place at rest of this rung (polarity and number), level_n the edge's profile at a_n,
and the overshoot of :func:`overshoot_px` (v tau(level) in slow motion). The spread of the levels
gives tau_white, the common part the lag of the positions. The skew, of opposite sign for the two
polarities, takes up leak and dead time and is discarded.

A pixel is a first-order low-pass in log intensity whose corner grows with the light (Hu, Liu,
Delbruck 2021, doi:10.1109/CVPRW53098.2021.00144), in one dimension:

    dv/dt = (L(q) - v) / tau,    tau = tau_white (1 + B) / (I + B),    I = contrast^(L - 1)

with L the log intensity from 0 (ground) to 1 (marker), I the light relative to white and B the dark
current (or veiling light) in the same unit. Everything depends on kappa = speed * tau_white, px.

An edge hardly shows B: it is a prior, and its spread is part of the uncertainty. What does not
depend on light at all (a bus, a driver's clock) stays unseen and has to be measured otherwise.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import EventSource
from spikingtac.events.windows import windows
from spikingtac.markers.crossings import (
    Crossings,
    CrossingStatistics,
    MarkerTrack,
    crossing_statistics,
    marker_track,
    observe_crossings,
)
from spikingtac.markers.graded.appearance import has_rare_off
from spikingtac.markers.graded.tracker import GradedTracker, GradedTrackerConfig

# Values of tau_white that are tried, us: 27 Hz at white at most, 1.6 % apart.
TRIED_US = np.geomspace(10.0, 6_000.0, 400)

# Equally likely dark currents B, relative to white (0: none; 0.12: v2e's offset of 20 at a white
# of 170).
DARK = 0.0, 0.06, 0.12

FLOOR_US = 100.0  # Uncertainty of the lag by what the model leaves out, us.

# A measurement that is no better is not used, us: lags are 500 us in good light, 2500 us in dim.
LARGEST_ERROR_US = 1_000.0

TABLE_PER_E_FOLD = 8  # Entries of the overshoot's table for each factor of e in kappa.
LEAST_RUNGS = 2  # Rungs of each polarity without which level and skew cannot be told apart.

GRID_PX = 0.01  # Resolution of the profile: a fiftieth of an edge's width.

# How far behind the edge a pixel is followed, in its slowest lengths: e^-12 is left then; but at
# most this far, px (just under half a marker pitch, where the next edge comes).
TRAIL, LONGEST_TRAIL_PX = 12.0, 16.0
MARGIN_WIDTHS = 12.0  # Logistic scales from an edge at which the light is even to 1e-5.

PERIOD_US = 1_000  # Time between tracked positions: at 100 px/s an edge moves by 0.1 px.

# Places in between of two estimates are on a straight line: with fewer events than this a marker
# nothing moves by much, and within this time nothing moves far. (Presses last a sixth of a
# recording: it is read three times as fast.)
LONGEST_US, EVENTS_PER_MARKER = 8_000, 0.5

# So many markers' edges tell the lag of a larger skin: each event is compared with all of them.
MOST_MARKERS = 128


@dataclass(frozen=True, slots=True)
class LagEstimate:
    """How late tracked positions are.

    Attributes:
        lag_us: Delay behind the true motion, us.
        uncertainty_us: One standard deviation, us.
        samples: Events that were used.
    """

    lag_us: float
    uncertainty_us: float
    samples: int


def slide_lag_us(source: EventSource, calibration: Calibration) -> float | None:
    """Return the lag of a recording of slides, us, or None where it cannot be seen.

    The recording is tracked without any lag correction.

    Args:
        source: The slides; read twice.
        calibration: What the slides taught so far.
    """
    if calibration.contrast is None or calibration.edge_px is None:
        return None
    fit = "bands" if has_rare_off(calibration) else "disc"
    tracker = GradedTracker(GradedTrackerConfig(lag_us=0.0, backlash=0.0), calibration, fit=fit)
    track = tracked(source, tracker, calibration)
    edge = DiscProfile(calibration.contrast, calibration.edge_px)
    estimate = estimate_lag(observe_crossings(source, track, source.size), edge)
    return None if estimate is None else estimate.lag_us


def tracked(source: EventSource, tracker: GradedTracker, calibration: Calibration) -> MarkerTrack:
    """Return where the edges of a recording's markers are, by a tracker without lag correction."""
    radius_px = calibration.radius_px
    chosen = np.unique(np.linspace(0, len(radius_px) - 1, MOST_MARKERS).astype(np.int64))
    t_us: list[int] = []
    rows: list[int] = []
    center_px = []
    waiting = 0
    for window in windows(source, PERIOD_US):
        tracker.absorb(window)
        t_us.append(window.t_end_us)
        waiting += len(window)
        since_us = window.t_end_us - t_us[rows[-1]] if rows else LONGEST_US
        if waiting >= EVENTS_PER_MARKER * len(radius_px) or since_us >= LONGEST_US:
            frame = tracker.estimate(window.t_end_us)
            coasted = frame.coasted[chosen, np.newaxis]
            center_px.append(np.where(coasted, np.nan, frame.detected_px[chosen]))
            rows.append(len(t_us) - 1)
            waiting = 0
    every, columns = np.arange(len(t_us)), np.array(center_px).reshape(len(rows), 2 * len(chosen)).T
    places = np.array([np.interp(every, rows, column) for column in columns if rows])
    places = places.T.reshape(len(t_us), len(chosen), 2)
    dark = calibration.polarity == "dark"
    return marker_track(np.array(t_us, np.int64), places, radius_px[chosen], dark)


def estimate_lag(
    crossings: Crossings, edge: DiscProfile, dark: tuple[float, ...] = DARK
) -> LagEstimate | None:
    """Return the lag of the positions with which the crossings were collected; None if unseen.

    Args:
        crossings: From :func:`~spikingtac.markers.crossings.observe_crossings`.
        edge: The calibrated edge.
        dark: Equally likely dark currents, relative to white.
    """
    statistics = crossing_statistics(crossings, edge)
    if min(np.count_nonzero(statistics.facing == side) for side in (-1, 1)) < LEAST_RUNGS:
        return None
    fits = 1e6 * np.array([_fit_s(statistics, edge, current) for current in dark])
    lag_us, spread_us = fits.T
    error_us = float(np.sqrt((spread_us**2).mean() + lag_us.var() + FLOOR_US**2))
    if not error_us < LARGEST_ERROR_US:
        return None
    return LagEstimate(max(0.0, float(lag_us.mean())), error_us, int(statistics.count.sum()))


def _fit_s(statistics: CrossingStatistics, edge: DiscProfile, dark: float) -> tuple[float, float]:
    """Return the lag and its uncertainty for one dark current, s."""
    white_s = TRIED_US * 1e-6
    # The rungs' levels come from their resting places, which the overshoot shifts a little.
    at_rest_px = statistics.resting_px
    solved, misfit, _ = _solve(statistics, _overshoots(statistics, edge, at_rest_px, dark, white_s))
    rungs = len(at_rest_px)
    at_rest_px = statistics.facing * solved[:rungs, int(np.argmin(misfit))]
    solved, misfit, variance = _solve(
        statistics, _overshoots(statistics, edge, at_rest_px, dark, white_s)
    )
    weight = np.exp(-0.5 * (misfit - misfit.min()))
    weight /= weight.sum()
    lag_s = solved[rungs]
    mean_s = float(weight @ lag_s)
    return mean_s, float(np.sqrt(weight @ (lag_s - mean_s) ** 2 + variance))


def _solve(
    statistics: CrossingStatistics, expected_px: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return ``(r + 2, trials)`` solutions, their misfits, and the variance of row r, the lag.

    Rows: resting places along the motion, lag, skew. Misfits and variance are scaled so that the
    best solution fits as well as it should.
    """
    rungs = len(statistics.facing)
    design = np.zeros((len(statistics.rung), rungs + 2))
    design[np.arange(len(statistics.rung)), statistics.rung] = 1.0
    design[:, rungs] = -statistics.speed_px_s
    design[:, rungs + 1] = statistics.facing[statistics.rung] * statistics.speed_px_s
    design /= statistics.error_px[:, None]
    target = (statistics.along_px[:, None] - expected_px) / statistics.error_px[:, None]
    solved = np.asarray(np.linalg.lstsq(design, target, rcond=None)[0], np.float64)
    misfit = ((target - design @ solved) ** 2).sum(axis=0)
    freedom = max(1, design.shape[0] - design.shape[1] - 1)
    scale = max(1.0, float(misfit.min()) / freedom)
    variance = float(np.linalg.pinv(design.T @ design)[rungs, rungs])
    return solved, misfit / scale, variance * scale


def _overshoots(
    statistics: CrossingStatistics,
    edge: DiscProfile,
    resting_px: NDArray[np.float64],
    dark: float,
    white_s: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return ``(n, trials)`` overshoots of the entries, px, from a table over kappa."""
    kappa_px = statistics.speed_px_s[:, None] * white_s
    low, high = np.log(kappa_px.min()), np.log(kappa_px.max())
    places = np.linspace(low, high, int((high - low) * TABLE_PER_E_FOLD) + 2)
    overshoot = np.empty_like(kappa_px)
    for facing in (-1.0, 1.0):
        rungs = np.flatnonzero(statistics.facing == facing)
        levels = edge.level(resting_px[rungs])
        table_px = overshoot_px(edge, facing < 0.0, levels, np.exp(places), dark)
        for rung, column in zip(rungs, (table_px / np.exp(places)[:, None]).T, strict=True):
            of = statistics.rung == rung
            overshoot[of] = kappa_px[of] * np.interp(np.log(kappa_px[of]), places, column)
    return overshoot


def slowness(edge: DiscProfile, level: NDArray[np.float64], dark: float) -> NDArray[np.float64]:
    """Return tau over tau_white at a level, (1 + B) / (I + B)."""
    return (1.0 + dark) / (edge.contrast ** (level - 1.0) + dark)


def place_px(edge: DiscProfile, level: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where a level inside (0, 1) is met, px: the inverse of the profile."""
    share = np.expm1(np.clip(level, 1e-6, 1.0 - 1e-6) * np.log(edge.contrast))
    return edge.edge_px * np.log((edge.contrast - 1.0) / share - 1.0)


def overshoot_px(
    edge: DiscProfile,
    brightening: bool,
    levels: NDArray[np.float64],
    kappa_px: NDArray[np.float64],
    dark: float,
) -> NDArray[np.float64]:
    """Return how far past a level's place an edge is when the pixel reports that level.

    Args:
        edge: Light across the edge.
        brightening: True for an edge that brings light.
        levels: ``(k,)`` levels inside (0, 1).
        kappa_px: ``(n,)`` speed times tau_white, px, positive.
        dark: B, relative to white.

    Returns:
        ``(n, k)`` px along the motion, positive; ``kappa * slowness(level)`` for small kappa.
    """
    margin_px, slow = MARGIN_WIDTHS * edge.edge_px, float(slowness(edge, np.zeros(1), dark)[0])
    trail_px = min(LONGEST_TRAIL_PX, TRAIL * slow * float(kappa_px.max()))
    along = np.arange(-margin_px, margin_px + trail_px, GRID_PX)
    side = -1.0 if brightening else 1.0
    level = edge.level(side * along)
    # What pixels make of a level that changes evenly from place to place: ``(places, n)``.
    seen = np.full((len(level), len(kappa_px)), level[0])
    lengths_px = kappa_px * slowness(edge, 0.5 * (level[1:] + level[:-1]), dark)[:, np.newaxis]
    for i, length_px in enumerate(lengths_px, start=1):
        behind = length_px * (level[i] - level[i - 1]) / GRID_PX
        rest = seen[i - 1] - level[i - 1] + behind
        seen[i] = level[i] - behind + rest * np.exp(-GRID_PX / length_px)
    rising, asked = (seen, levels) if brightening else (1.0 - seen, 1.0 - levels)
    # Strictly increasing for the inverse lookup, where float rounding left a plateau.
    rising = np.maximum.accumulate(rising, axis=0) + np.arange(len(along))[:, None] * 1e-12
    reached = np.stack([np.interp(asked, column, along) for column in rising.T])
    return reached - side * place_px(edge, levels)
