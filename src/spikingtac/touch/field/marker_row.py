"""Markers that lie in one row: across it nothing is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.pitch import marker_pitch_px

Field = NDArray[np.float64]

TOLERANCE = 0.1
"""Root mean square distance from a line, in pitches, up to which markers lie on it (ours): a row's
places err and bend as much, and it is too little to tell a slope by."""


def straightened(reference: Field) -> Field | None:
    """Return markers ``(m, 2)`` of one row, each moved onto the row's line; None of any others.

    Raises:
        ConfigError: Fewer than two markers.
    """
    middle = reference.mean(axis=0)
    away = reference - middle
    _, extent, axes = np.linalg.svd(away, full_matrices=False)
    if extent[1] > TOLERANCE * marker_pitch_px(reference) * np.sqrt(len(reference)):
        return None
    return middle + np.outer(away @ axes[0], axes[0])
