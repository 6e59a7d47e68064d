"""Mean places of an edge at each event that its crossing causes, with uncertainties.

A rung is one polarity and one number of event within a passage;
:mod:`spikingtac.markers.lag.crossings` collects them, :mod:`spikingtac.markers.lag.estimate`
explains how their places depend on speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.lag.crossings import PLACE_BINS, REACH_PX, Crossings

# Places further from a bin's median are noise events: three times the spread of an edge's own.
TRIM_PX = 1.0
_FEWEST_SPEEDS = 3


@dataclass(frozen=True, slots=True)
class CrossingStatistics:
    """Mean places, one entry for each rung and bin of speed; n entries, r rungs.

    Attributes:
        rung: ``(n,)`` index of the entry's rung.
        facing: ``(r,)`` by rung: 1 where the edge takes light away, -1 where it brings light.
        speed_px_s: ``(n,)`` mean speed of the edge over the pixel.
        along_px: ``(n,)`` mean place of the edge beyond the pixel, along the motion, px.
        error_px: ``(n,)`` its uncertainty, px.
        count: ``(n,)`` events.
    """

    rung: NDArray[np.int64]
    facing: NDArray[np.float64]
    speed_px_s: NDArray[np.float64]
    along_px: NDArray[np.float64]
    error_px: NDArray[np.float64]
    count: NDArray[np.int64]

    def resting_px(self) -> NDArray[np.float64]:
        """Return ``(r,)`` places q at vanishing speed by straight lines; NaN where unknown."""
        places = np.full(len(self.facing), np.nan)
        for rung in range(len(places)):
            of = self.rung == rung
            if np.count_nonzero(of) >= _FEWEST_SPEEDS:
                weight = 1.0 / self.error_px[of]
                line = np.polyfit(self.speed_px_s[of], self.along_px[of], 1, w=weight)
                places[rung] = self.facing[rung] * line[1]
        return places

    def select(self, rungs: NDArray[np.bool_]) -> CrossingStatistics:
        """Return the chosen rungs, numbered anew."""
        keep = rungs[self.rung]
        return CrossingStatistics(
            (np.cumsum(rungs) - 1)[self.rung[keep]],
            self.facing[rungs],
            self.speed_px_s[keep],
            self.along_px[keep],
            self.error_px[keep],
            self.count[keep],
        )


def crossing_statistics(
    crossings: Crossings, least_count: int, floor_px: float
) -> CrossingStatistics:
    """Return the means of all bins with enough events.

    Args:
        crossings: Collected places.
        least_count: Events that a bin needs.
        floor_px: Added in quadrature to every uncertainty, px.
    """
    number = crossings.count.sum(axis=3)
    side, order, speeds = np.nonzero(number >= max(1, least_count))
    counts = crossings.count[side, order, speeds].astype(np.float64)
    mean_px, error_px = trimmed_means(counts)
    rungs, rung = np.unique(side * number.shape[1] + order, return_inverse=True)
    facing = np.where(rungs < number.shape[1], -1.0, 1.0)
    return CrossingStatistics(
        rung,
        facing,
        crossings.speed_sum_px_s[side, order, speeds] / number[side, order, speeds],
        facing[rung] * mean_px,
        np.hypot(error_px, floor_px),
        number[side, order, speeds],
    )


def trimmed_means(
    counts: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``(n,)`` means within TRIM_PX of the median and their errors, px.

    Args:
        counts: ``(n, PLACE_BINS)`` events by place from -REACH_PX to REACH_PX; no row is empty.
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
