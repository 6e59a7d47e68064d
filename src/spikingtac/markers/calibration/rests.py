"""When the skin rests, and at which of these rests nothing touches it.

A static press is as silent as no contact, so a stretch of silence is only a candidate. What the
pixels show in it decides: the skin looks the same at all rests without load, while presses differ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.buffered_events import BufferedEvents

SMOOTH_PX = 3
"""Width of the box mean before two maps are compared: single pixels are noise."""

CHANGED_LEVEL = 0.5
"""A pixel differs between two rests when its level differs by half a swing."""

ALIKE_SHARE = 0.05
"""Two rests are alike up to this share of the pixels that differ between unlike rests. Creep leaves
less than 0.02, a light press 0.1 and more (simulated and recorded presses)."""

ALIKE_PX = 40.0
"""Two rests are always alike up to so many differing pixels: a third of one marker."""

FIRST_BONUS = 0.5
"""A recording mostly begins without load: its first rest counts half as much again."""


BIN_US, SMOOTH_BINS = 10_000, 5
"""Events are counted in bins of this length, and summed over so many: 10 ms hold a hundred events
of a quiet 320x320 sensor at 0.1 Hz a pixel."""

QUIET_SHARE, QUIET_PERCENTILE = 0.03, 5.0
"""A bin is quiet up to this share of the way from the quietest, the fifth percentile, to the busy
ones (ours: creep after a contact is 0.01 to 0.02)."""

SHORTEST_REST_US = 100_000
"""A rest lasts at least this long; a slide turns round in less."""

MOST_RESTS = 40
"""The longest so many rests are used: each keeps a map in memory."""


def quiet_limit(counts: NDArray[np.float64], deviations: float = 3.0) -> float:
    """Return the count up to which a bin is quiet.

    Args:
        counts: Events of each bin.
        deviations: Standard deviations of Poisson noise, above the quietest, that are no motion.
    """
    floor = float(np.percentile(counts, QUIET_PERCENTILE))
    # Half of all events fall into bins at least as busy as this one.
    busiest = np.sort(counts)[::-1]
    busy = float(busiest[np.searchsorted(np.cumsum(busiest), 0.5 * busiest.sum())])
    return floor + max(QUIET_SHARE * (busy - floor), deviations * (np.sqrt(floor) + 1.0))


def find_rests(events: BufferedEvents) -> NDArray[np.int64]:
    """Return ``(n, 2)`` first and last time of each rest, us since the start, in order."""
    edges_us = np.arange(max(1, events.duration_us // BIN_US) + 1, dtype=np.int64) * BIN_US
    single = np.diff(events.index_at(edges_us)).astype(float)
    counts = np.convolve(single, np.ones(SMOOTH_BINS), "same")
    quiet = np.concatenate([[False], counts <= quiet_limit(counts), [False]])
    begins = np.flatnonzero(~quiet[:-1] & quiet[1:])
    ends = np.flatnonzero(quiet[:-1] & ~quiet[1:])
    rests = np.column_stack([begins, ends]) * BIN_US
    rests = rests[np.diff(rests, axis=1)[:, 0] >= SHORTEST_REST_US]
    longest = np.argsort(rests[:, 0] - rests[:, 1], kind="stable")[:MOST_RESTS]
    return rests[np.sort(longest)]


def moving_events(events: BufferedEvents, rests_us: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return ``bool[n]``: which events fall outside of the rests (all, where that is none)."""
    moving = np.ones(len(events), bool)
    for first, last in events.index_at(rests_us.ravel()).reshape(-1, 2):
        moving[first:last] = False
    return moving if moving.any() else ~moving


def unloaded_rests(maps: NDArray[np.float32], length_us: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return ``bool[rests]``: at which rests nothing touches the skin.

    Rests that look alike, or are linked by others that do, are one group; the group that lasts
    longest is without load.

    Args:
        maps: ``(rests, height, width)`` level maps.
        length_us: ``(rests,)`` how long each lasts, us.
    """
    # Late imports: together they take a fifth of a second, which every verb's start would wait for.
    from scipy.ndimage import uniform_filter
    from scipy.sparse.csgraph import connected_components

    smooth = np.array([uniform_filter(level, SMOOTH_PX) for level in maps])
    changed = np.array(
        [
            [np.count_nonzero(np.abs(one - other) > CHANGED_LEVEL) for other in smooth]
            for one in smooth
        ]
    )
    limit = max(ALIKE_SHARE * float(np.percentile(changed, 90)), ALIKE_PX)
    _, group = connected_components(changed < limit)
    weight = np.bincount(group, length_us).astype(float)
    weight[group[0]] += FIRST_BONUS * length_us[0]
    return np.asarray(group == weight.argmax())
