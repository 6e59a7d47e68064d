"""What simpler methods feel.

Force from the mean displacement, touches from event counts, patches from whatever is largest.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration import marker_pitch_px
from spikingtac.touch import SQUARE, Patch, WrenchSeries, patch_of_cells

Field = NDArray[np.float64]

EVENT_SIGMAS = 6.0
"""Deviations above the quiet mean at which a window of events is a touch."""
QUIET_WINDOWS = 30
"""Windows from the start of a recording that are quiet."""


class MeanDisplacement:
    """Linear regression of the wrench on the markers' mean displacement and its length."""

    def __init__(self, series: Iterable[WrenchSeries]) -> None:
        """Learn from labelled series."""
        taught = list(series)
        features = np.concatenate([_features(one) for one in taught])
        wrench = np.concatenate([one.wrench for one in taught])
        self._weights = np.linalg.lstsq(features, wrench, rcond=None)[0]

    def estimate(self, series: WrenchSeries) -> Field:
        """Return the wrench ``(n, c)`` of a series."""
        return _features(series) @ self._weights


def _features(series: WrenchSeries) -> Field:
    mean = series.displacement.mean(axis=1)
    length = np.sqrt((series.displacement**2).sum(axis=2)).mean(axis=1)
    return np.column_stack([mean, length, np.ones(len(mean))])


def event_touches(counts: NDArray[np.int64], window_us: int) -> list[tuple[int, int]]:
    """Return begin and end, us, of the stretches in which events exceed their quiet rate.

    Args:
        counts: ``(n,)`` events in each window; the first are quiet.
        window_us: Length of a window, us.
    """
    quiet = counts[:QUIET_WINDOWS]
    threshold = float(quiet.mean()) + EVENT_SIGMAS * max(float(quiet.std()), 1.0)
    above = np.concatenate([[False], counts > threshold, [False]])
    edges = np.flatnonzero(np.diff(above.astype(np.int8)))
    return [(int(a) * window_us, int(b) * window_us) for a, b in edges.reshape(-1, 2)]


def region_above(reference_px: Field, values: Field, share: float) -> Patch:
    """Return the markers whose value is at least a share of the largest, each with its square.

    Args:
        reference_px: ``(m, 2)`` markers at rest, px.
        values: ``(m,)`` what is seen at each, not negative.
        share: The share.
    """
    pitch_px = marker_pitch_px(reference_px)
    inside = values >= share * float(values.max())
    corners = reference_px[inside, None] + pitch_px * SQUARE
    return patch_of_cells(corners, np.maximum(values[inside], 1e-12))
