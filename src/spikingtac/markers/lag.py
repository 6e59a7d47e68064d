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
of opposite sign for the two polarities, takes up leak and dead time and is discarded. So each rung
is a straight line of places over speeds, and the slopes of all rungs are linear in lag, skew, and
tau_white.

An edge hardly shows B: it is a prior, and its spread is part of the uncertainty. What does not
depend on light at all (a bus, a driver's clock) stays unseen and has to be measured otherwise.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import EventSource
from spikingtac.events.windows import windows
from spikingtac.markers.crossings import (
    PERIOD_US,
    PLACE_BINS,
    REACH_PX,
    Crossings,
    MarkerTrack,
    marker_track,
    observe_crossings,
)
from spikingtac.markers.graded.tracker import GradedTracker, GradedTrackerConfig
from spikingtac.types import EventPacket, MarkerFrame

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
    estimate = estimate_lag(
        observe_crossings(source, track, source.size),
        DiscProfile(calibration.contrast, calibration.edge_px),
    )
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
    return marker_track(
        np.array(t_us, np.int64), places, radius_px[chosen], calibration.polarity == "dark"
    )


def estimate_lag(crossings: Crossings, edge: DiscProfile) -> tuple[float, float] | None:
    """Return the lag of positions and its standard deviation, us; None where it cannot be seen.

    Args:
        crossings: Those of the tracked positions.
        edge: The calibrated edge.
    """
    rungs = rung_lines(crossings)
    level = edge.level(rungs[:, 1])
    told = (level > LOWEST_LEVEL) & (level < HIGHEST_LEVEL)
    (facing, _, slope_s, error_s, bent, free), level = rungs[told].T, level[told]
    if min(np.count_nonzero(facing == side) for side in (-1, 1)) < LEAST_RUNGS:
        return None
    design = np.column_stack([-np.ones(len(level)), facing, slowness(edge, level, DARK)])
    design /= error_s[:, np.newaxis]
    solved = np.linalg.lstsq(design, slope_s / error_s, rcond=None)[0]
    misfit = bent.sum() + ((slope_s / error_s - design @ solved) ** 2).sum()
    scale = max(1.0, misfit / (free.sum() + len(level) - 3))
    spread_us = 1e6 * np.sqrt(scale * np.linalg.pinv(design.T @ design)[0, 0])
    lag_us = max(0.0, 1e6 * float(solved[0]))
    error_us = float(np.sqrt(spread_us**2 + (DARK_SHARE * lag_us) ** 2 + FLOOR_US**2))
    return (lag_us, error_us) if error_us < LARGEST_ERROR_US else None


def rung_lines(crossings: Crossings) -> NDArray[np.float64]:
    """Fit a straight line to the mean places of each rung over the speed.

    Returns:
        ``(r, 6)``: 1 where the edge takes light away and -1 where it brings light; place q at
        rest, px; way along the motion per speed, s, and its error; sum of the squares of what the
        line leaves, in errors, and degrees of freedom.
    """
    number, lines = crossings.count.sum(axis=3), []
    for rung in np.ndindex(number.shape[:2]):
        bins = number[rung] >= LEAST_COUNT
        if np.count_nonzero(bins) < FEWEST_SPEEDS:
            continue
        mean_px, error_px = trimmed_means(crossings.count[rung][bins].astype(np.float64))
        speed_px_s = crossings.speed_sum_px_s[rung][bins] / number[rung][bins]
        facing, weight = (-1.0, 1.0)[rung[0]], 1.0 / np.hypot(error_px, FLOOR_PX)
        along_px = facing * mean_px
        line, covariance = np.polyfit(speed_px_s, along_px, 1, w=weight, cov="unscaled")
        bent = ((weight * (along_px - np.polyval(line, speed_px_s))) ** 2).sum()
        slope, free = (line[0], np.sqrt(covariance[0, 0])), np.count_nonzero(bins) - 2
        lines.append((facing, facing * line[1], *slope, bent, free))
    return np.array(lines).reshape(-1, 6)


def trimmed_means(
    counts: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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


def slowness(edge: DiscProfile, level: NDArray[np.float64], dark: float) -> NDArray[np.float64]:
    """Return tau over tau_white at a level, (1 + B) / (I + B)."""
    return (1.0 + dark) / (edge.contrast ** (level - 1.0) + dark)
