"""The lag of a whole recording: track it, then look where the tracked edges stood."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.events.source import EventSource
from spikingtac.events.windows import windows
from spikingtac.markers.graded.appearance import has_rare_off
from spikingtac.markers.graded.tracker import GradedTracker, GradedTrackerConfig
from spikingtac.markers.lag.crossings import CrossingObserver, MarkerTrack
from spikingtac.markers.lag.estimate import LagConfig, LagEstimate, estimate_lag
from spikingtac.markers.lag.photoreceptor import EdgeProfile
from spikingtac.markers.registry import MarkerTracker

PERIOD_US = 1_000  # Time between tracked positions: at 100 px/s an edge moves by 0.1 px.

# Places in between of two estimates are on a straight line: with fewer events than this a marker
# nothing moves by much, and within this time nothing moves far. (Presses last a sixth of a
# recording: it is read three times as fast.)
LONGEST_US, EVENTS_PER_MARKER = 8_000, 0.5

# So many markers' edges tell the lag of a larger skin: each event is compared with all of them.
MOST_MARKERS = 128


def recording_lag(
    source: EventSource,
    tracker: MarkerTracker,
    calibration: Calibration,
    config: LagConfig | None = None,
) -> LagEstimate:
    """Return how late a tracker's positions are, without knowing the truth.

    Args:
        source: A recording of markers in motion; it is read twice.
        tracker: Made for this calibration, with its own lag correction at 0.
        calibration: With radii, contrast and edge.
        config: Priors and limits of the estimate.

    Raises:
        ConfigError: The calibration has no contrast or no edge width.
    """
    if calibration.contrast is None or calibration.edge_px is None:
        raise ConfigError(
            "the lag needs contrast and edge_px in the calibration; "
            "calibrate from a recording of slides first"
        )
    track = _tracked(source, tracker, calibration)
    observer = CrossingObserver(track, source.size)
    for packet in source:
        observer.absorb(packet)
    edge = EdgeProfile(contrast=calibration.contrast, edge_px=calibration.edge_px)
    return estimate_lag(observer.crossings, edge, config)


def slide_lag_us(source: EventSource, calibration: Calibration) -> float | None:
    """Return the lag of a recording of slides, us, or None where it cannot be seen.

    The recording is tracked without any lag correction.

    Args:
        source: The slides; read twice.
        calibration: What the slides taught so far.
    """
    fit = "bands" if has_rare_off(calibration) else "disc"
    tracker = GradedTracker(GradedTrackerConfig(lag_us=0.0, backlash=0.0), calibration, fit=fit)
    estimate = recording_lag(source, tracker, calibration)
    return estimate.lag_us if estimate.samples else None


def _tracked(source: EventSource, tracker: MarkerTracker, calibration: Calibration) -> MarkerTrack:
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
    places = _on_lines(rows, np.array(center_px).reshape(len(rows), len(chosen), 2), len(t_us))
    dark = calibration.polarity == "dark"
    return MarkerTrack(np.array(t_us, np.int64), places, radius_px[chosen], dark)


def _on_lines(rows: list[int], center_px: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return ``(count, m, 2)`` places in all rows from those in some, which begin with row 0."""
    if not rows:
        return center_px
    every = np.arange(count)
    before = np.searchsorted(rows, every, side="right") - 1
    after = np.minimum(before + 1, len(rows) - 1)
    at = np.array(rows)
    share = (every - at[before]) / np.maximum(at[after] - at[before], 1)
    share = share[:, np.newaxis, np.newaxis]
    # What is known exactly stays: nothing is added to it that may be missing.
    known = np.where(share > 0.0, (1.0 - share) * center_px[before] + share * center_px[after], 0.0)
    return np.where(share > 0.0, known, center_px[before])
