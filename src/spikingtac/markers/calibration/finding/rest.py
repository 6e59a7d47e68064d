"""When the skin rests, and at which of these rests nothing touches it.

A static press is as silent as no contact, so a stretch of silence is only a candidate. What the
pixels show in it decides: the skin looks the same at all rests without load, while presses differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
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


@dataclass(frozen=True, kw_only=True, slots=True)
class RestConfig:
    """How rest is distinguished from motion; all values are ours.

    Attributes:
        bin_us: Events are counted in bins of this length. 10 ms hold a hundred events of a quiet
            320x320 sensor at 0.1 Hz/px.
        smooth_bins: Counts are summed over so many bins.
        quiet_share: A bin is quiet up to this share of the way from the quietest to the busy ones.
        quiet_percentile: Percentile of the bins' counts that stands for the noise alone.
        shortest_us: A rest lasts at least this long; a slide turns round in less.
        most_rests: The longest so many rests are used: each keeps a map in memory.
    """

    bin_us: int = 10_000
    smooth_bins: int = 5
    quiet_share: float = 0.03
    quiet_percentile: float = 5.0
    shortest_us: int = 100_000
    most_rests: int = 40

    def __post_init__(self) -> None:
        if self.bin_us < 1 or self.shortest_us < self.bin_us:
            raise ConfigError(
                f"bin_us {self.bin_us} and shortest_us {self.shortest_us} must be positive and in "
                "this order"
            )
        if self.smooth_bins < 1 or self.most_rests < 1:
            raise ConfigError("smooth_bins and most_rests must be positive")


def find_rests(events: BufferedEvents, config: RestConfig) -> NDArray[np.int64]:
    """Return ``(n, 2)`` first and last time of each rest, us since the start, in order."""
    bins = max(1, events.duration_us // config.bin_us)
    edges_us = np.arange(bins + 1, dtype=np.int64) * config.bin_us
    single = np.diff(events.index_at(edges_us)).astype(float)
    counts = np.convolve(single, np.ones(config.smooth_bins), "same")
    floor = float(np.percentile(counts, config.quiet_percentile))
    # Half of all events fall into bins at least as busy as this one.
    busiest = np.sort(counts)[::-1]
    busy = busiest[np.searchsorted(np.cumsum(busiest), 0.5 * busiest.sum())]
    # Three sigma of Poisson noise: counts above the floor's own scatter are motion.
    limit = floor + max(config.quiet_share * (busy - floor), 3.0 * np.sqrt(floor) + 3.0)
    quiet = np.concatenate([[False], counts <= limit, [False]])
    begins = np.flatnonzero(~quiet[:-1] & quiet[1:])
    ends = np.flatnonzero(quiet[:-1] & ~quiet[1:])
    rests = np.column_stack([begins, ends]) * config.bin_us
    length_us = rests[:, 1] - rests[:, 0]
    rests, length_us = (value[length_us >= config.shortest_us] for value in (rests, length_us))
    longest = np.argsort(-length_us, kind="stable")[: config.most_rests]
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
