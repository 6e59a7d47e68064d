"""A state map painted from a calibration, so that a calibrated sensor needs no new slides.

The paper begins with a null map and slides an object over the skin before each session (section
IV-B). A sensor whose markers are known at rest can begin with them instead: ours.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def paint_discs(
    size: tuple[int, int], reference_px: NDArray[np.float64], radius_px: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Paint discs with smooth edges: each pixel holds the share of it that a disc covers.

    The share is that of a straight edge at the pixel centre's distance from the rim, which differs
    from the exact one by less than 0.1 for discs of 3 px and more (at a diagonal rim).

    Args:
        size: ``(width, height)``, px.
        reference_px: ``(m, 2)`` centres, px; they may lie beyond the border.
        radius_px: ``(m,)`` radii, px.

    Returns:
        ``(height, width)`` float32 from 0 to 1.

    Example:
        >>> import numpy as np
        >>> paint_discs((9, 9), np.array([[4.0, 4.0]]), np.array([2.0]))[4].tolist()
        [0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0]
    """
    width, height = size
    out = np.zeros((height, width), np.float32)
    for (x, y), radius in zip(np.asarray(reference_px, np.float64), radius_px, strict=True):
        reach = float(radius) + 1.0
        columns = slice(max(0, math.floor(x - reach)), max(0, min(width, math.ceil(x + reach) + 1)))
        rows = slice(max(0, math.floor(y - reach)), max(0, min(height, math.ceil(y + reach) + 1)))
        dx = np.arange(columns.start, columns.stop) - x
        dy = np.arange(rows.start, rows.stop) - y
        distance = np.hypot(dx[np.newaxis, :], dy[:, np.newaxis])
        cover = np.clip(radius - distance + 0.5, 0.0, 1.0).astype(np.float32)
        np.maximum(out[rows, columns], cover, out=out[rows, columns])
    return out


def paint_binary_discs(
    size: tuple[int, int], reference_px: NDArray[np.float64], radius_px: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Paint discs of ones: the pixels whose centre a disc covers; see :func:`paint_discs`."""
    half = np.float32(0.5)  # the cover of a pixel whose centre lies on the rim
    return (paint_discs(size, reference_px, radius_px) >= half).astype(np.float32)
