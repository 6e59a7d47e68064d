"""Rate, noise and hot pixels of a camera, from its events alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import EventPacket

WINDOW_US = 10_000
"""Window by which quiet stretches are found: long enough for some noise events on 320x320 px."""
QUIET_SHARE = 0.1
"""Fraction of the windows, those with the fewest events, that counts as noise alone (ours: a sensor
that is touched rests for more of its time than this)."""
HOT_DEVIATIONS = 6.0
"""A pixel is hot beyond so many standard deviations of the noise of the others (ours).
The noise is Poisson distributed, its standard deviation the root of its mean."""
HOT_LEAST_EVENTS = 5
"""A hot pixel sent more events than this in the quiet windows (ours: fewer come by chance)."""
US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True)
class EventQuality:
    """Figures of a stretch of events.

    Attributes:
        rate_hz: Events per second.
        on_fraction: Fraction of ON events; None without events.
        noise_hz: Events per pixel and second in the quietest windows, hot pixels left out.
        hot_px: ``(h, 2)`` columns and rows of hot pixels.
    """

    rate_hz: float
    on_fraction: float | None
    noise_hz: float
    hot_px: NDArray[np.int64]


def judge_events(events: EventPacket) -> EventQuality:
    """Return the figures of a stretch of events.

    Noise is judged in the quietest tenth of the windows of 10 ms; a sensor that never rests
    therefore shows more noise than it has.
    """
    duration_us = max(events.t_end_us - events.t_start_us, 1)
    quiet, quiet_us = _quiet_part(events, duration_us)
    width, height = events.size
    places = events.y[quiet].astype(np.int64) * width + events.x[quiet]
    counts = np.bincount(places, minlength=width * height)
    hot = _hot(counts)
    left = counts[~hot]
    return EventQuality(
        rate_hz=len(events) * US_PER_S / duration_us,
        on_fraction=float(events.p.mean()) if len(events) else None,
        noise_hz=float(left.mean()) * US_PER_S / quiet_us if len(left) else 0.0,
        hot_px=np.column_stack(np.divmod(np.flatnonzero(hot), width)[::-1]),
    )


def _quiet_part(events: EventPacket, duration_us: int) -> tuple[NDArray[np.bool_], int]:
    """Return which events lie in the quietest windows, and the length of these windows, us."""
    windows = max(duration_us // WINDOW_US, 1)
    number = np.minimum((events.t - events.t_start_us) // WINDOW_US, windows - 1)
    counts = np.bincount(number, minlength=windows)
    chosen = np.zeros(windows, bool)
    chosen[np.argsort(counts, kind="stable")[: max(round(QUIET_SHARE * windows), 1)]] = True
    return chosen[number], int(chosen.sum()) * min(WINDOW_US, duration_us)


def _hot(counts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the pixels that send far more than the others; twice, since they raise the mean."""
    hot = np.zeros(len(counts), bool)
    for _ in range(2):
        mean = float(counts[~hot].mean()) if not hot.all() else 0.0
        hot = counts > max(mean + HOT_DEVIATIONS * mean**0.5, HOT_LEAST_EVENTS)
    return hot
