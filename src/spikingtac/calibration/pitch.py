"""The distance between neighbouring markers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError

FEWEST_MARKERS = 2

# Markers up to this many times the distance of the nearest one are neighbours: the other axis of
# a rectangular grid is, the diagonal of a square one is not.
NEIGHBOUR_SHARE = 1.25


def marker_pitch_px(reference_px: NDArray[np.float64]) -> float:
    """Return the median distance of markers ``(m, 2)`` from their nearest neighbours, px.

    Raises:
        ConfigError: There are fewer than two markers.
    """
    return float(np.median(_distances_px(reference_px).min(axis=1)))


def mean_pitch_px(reference_px: NDArray[np.float64]) -> float:
    """Return the mean distance of all neighbours among markers ``(m, 2)``, px.

    Raises:
        ConfigError: There are fewer than two markers.
    """
    away_px = _distances_px(reference_px)
    nearest_px = away_px.min(axis=1)
    reach_px = NEIGHBOUR_SHARE * np.minimum(nearest_px[:, None], nearest_px)
    return float(away_px[away_px <= np.maximum(reach_px, nearest_px[:, None])].mean())


def _distances_px(reference_px: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(reference_px) < FEWEST_MARKERS:
        raise ConfigError(
            f"{len(reference_px)} marker has no pitch, at least {FEWEST_MARKERS} are needed"
        )
    away_px = np.sqrt(((reference_px[:, None] - reference_px[None]) ** 2).sum(axis=2))
    np.fill_diagonal(away_px, np.inf)
    return away_px
