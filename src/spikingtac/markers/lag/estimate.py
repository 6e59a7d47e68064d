"""How far tracked markers are behind the true motion, from events alone.

A constant delay leaves no trace. A photoreceptor's delay does: it is inversely proportional to the
light, so that the dark levels of an edge come later than the bright ones, on leading and trailing
edges alike. Let an edge pass a pixel at speed v, and let its n-th event come when the tracked edge
is q beyond the pixel, along the motion. Then

    q = a_n + overshoot(level_n, v tau_white) - v lag +- v skew

with a_n the place at rest of this rung (polarity and number), level_n the edge's profile at a_n,
and the overshoot of :mod:`spikingtac.markers.lag.photoreceptor` (v tau(level) in slow motion). The
spread of the levels gives tau_white, the common part the lag of the positions. The skew, of
opposite sign for the two polarities, takes up leak and dead time and is discarded.

How the delay goes on towards brighter light depends on the dark current B, which an edge hardly
shows: it is a prior, and its spread is part of the uncertainty. What does not depend on light at
all (a bus, a driver's clock) stays unseen and has to be measured otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.markers.lag.crossing_statistics import CrossingStatistics, crossing_statistics
from spikingtac.markers.lag.crossings import Crossings
from spikingtac.markers.lag.photoreceptor import EdgeProfile, overshoot_px

_US_PER_S = 1e6
_TRIALS = 400  # Values of tau_white that are tried, 1.6 % apart over the default range.
_TABLE_PER_E_FOLD = 8  # Entries of the overshoot's table for each factor of e in kappa.
_LEAST_RUNGS = 2  # Rungs of each polarity without which level and skew cannot be told apart.
LOWEST_LEVEL = 0.12  # Below this level noise fires as often as the edge.
HIGHEST_LEVEL = 0.93  # Rungs above it belong to the pixels with the smallest steps only.
LEAST_COUNT = 60  # Events that a mean place needs.

# Uncertainty of a mean place by what the model leaves out (curved edges, mismatch between
# pixels), px (from noise-free recordings).
FLOOR_PX = 0.004
SHORTEST_US = 10.0  # Least tau_white that is tried, us.


@dataclass(frozen=True, kw_only=True, slots=True)
class LagConfig:
    """Prior values, and which events count.

    Attributes:
        default_us: Returned where nothing can be seen (between 500 us in good light and
            2500 us in dim light).
        default_uncertainty_us: Its uncertainty; a measurement that is no better is not used.
        dark: Equally likely dark currents B, relative to white (0: none; 0.12: v2e's offset of 20
            at a white of 170).
        floor_us: The same for the lag, us.
        longest_us: Greatest, us (27 Hz at white).
    """

    default_us: float = 1_000.0
    default_uncertainty_us: float = 1_000.0
    dark: tuple[float, ...] = (0.0, 0.06, 0.12)
    floor_us: float = 100.0
    longest_us: float = 6_000.0

    def __post_init__(self) -> None:
        if not self.dark or min(self.dark) < 0.0:
            raise ConfigError(f"dark is {self.dark}, it needs values of 0 or more")
        if not self.longest_us > SHORTEST_US:
            raise ConfigError(f"longest_us is {self.longest_us}, it must be above {SHORTEST_US:g}")


@dataclass(frozen=True, slots=True)
class LagEstimate:
    """How late tracked positions are.

    Attributes:
        lag_us: Delay behind the true motion, us.
        uncertainty_us: One standard deviation, us.
        white_us: The photoreceptor's time constant at the marker's light, us; NaN where nothing
            could be seen.
        samples: Events that were used; 0 where the default is returned.
    """

    lag_us: float
    uncertainty_us: float
    white_us: float
    samples: int


def estimate_lag(
    crossings: Crossings, edge: EdgeProfile, config: LagConfig | None = None
) -> LagEstimate:
    """Return the lag of the positions with which the crossings were collected.

    Args:
        crossings: From :func:`~spikingtac.markers.lag.crossings.observe_crossings`.
        edge: The calibrated edge.
        config: Priors and limits.
    """
    config = config or LagConfig()
    unseen = LagEstimate(config.default_us, config.default_uncertainty_us, float("nan"), 0)
    statistics = _usable(crossing_statistics(crossings, LEAST_COUNT, FLOOR_PX), edge, config)
    if min(np.count_nonzero(statistics.facing == side) for side in (-1, 1)) < _LEAST_RUNGS:
        return unseen
    fits = np.array([_fit_us(statistics, edge, dark, config) for dark in config.dark])
    lag_us, white_us, _ = fits.mean(axis=0)
    uncertainty_us = float(
        np.sqrt((fits[:, 2] ** 2).mean() + fits[:, 0].var() + config.floor_us**2)
    )
    if not uncertainty_us < config.default_uncertainty_us:
        return unseen
    return LagEstimate(
        max(0.0, float(lag_us)), uncertainty_us, float(white_us), int(statistics.count.sum())
    )


def _usable(
    statistics: CrossingStatistics, edge: EdgeProfile, config: LagConfig
) -> CrossingStatistics:
    level = edge.level(statistics.resting_px())
    return statistics.select((level > LOWEST_LEVEL) & (level < HIGHEST_LEVEL))


def _fit_us(
    statistics: CrossingStatistics, edge: EdgeProfile, dark: float, config: LagConfig
) -> tuple[float, float, float]:
    """Return (lag, tau_white, uncertainty of the lag) for one dark current, us."""
    white_s = np.geomspace(SHORTEST_US, config.longest_us, _TRIALS) / _US_PER_S
    # The rungs' levels come from their resting places, which the overshoot shifts a little.
    at_rest_px = statistics.resting_px()
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
    deviation_s = np.sqrt(weight @ (lag_s - mean_s) ** 2 + variance)
    return mean_s * _US_PER_S, float(weight @ white_s) * _US_PER_S, deviation_s * _US_PER_S


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
    edge: EdgeProfile,
    resting_px: NDArray[np.float64],
    dark: float,
    white_s: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return ``(n, trials)`` overshoots of the entries, px, from a table over kappa."""
    kappa_px = statistics.speed_px_s[:, None] * white_s
    low, high = np.log(kappa_px.min()), np.log(kappa_px.max())
    places = np.linspace(low, high, int((high - low) * _TABLE_PER_E_FOLD) + 2)
    overshoot = np.empty_like(kappa_px)
    for facing in (-1.0, 1.0):
        rungs = np.flatnonzero(statistics.facing == facing)
        levels = edge.level(resting_px[rungs])
        table_px = overshoot_px(edge, facing < 0.0, levels, np.exp(places), dark)
        for rung, column in zip(rungs, (table_px / np.exp(places)[:, None]).T, strict=True):
            of = statistics.rung == rung
            overshoot[of] = kappa_px[of] * np.interp(np.log(kappa_px[of]), places, column)
    return overshoot
