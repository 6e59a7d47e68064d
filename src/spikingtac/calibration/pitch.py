"""The distance between neighbouring markers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError

FEWEST_MARKERS = 2


def marker_pitch_px(reference_px: NDArray[np.float64]) -> float:
    """Return the median distance of markers ``(m, 2)`` from their nearest neighbours, px.

    Raises:
        ConfigError: There are fewer than two markers.
    """
    if len(reference_px) < FEWEST_MARKERS:
        raise ConfigError(
            f"{len(reference_px)} marker has no pitch, at least {FEWEST_MARKERS} are needed"
        )
    away_px2 = ((reference_px[:, None] - reference_px[None]) ** 2).sum(axis=2)
    np.fill_diagonal(away_px2, np.inf)
    return float(np.median(np.sqrt(away_px2.min(axis=1))))
