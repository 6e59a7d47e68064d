"""The displacement field as an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Level of a marker at rest, and levels on either side of it that are used.
NONE_LEVEL, LEVELS = 128, 127


def field_image(
    displacement_px: NDArray[np.floating],
    coasted: NDArray[np.bool_],
    grid: tuple[int, int],
    range_px: float,
    cell_px: int,
) -> NDArray[np.uint8]:
    """Return ``(rows * cell_px, columns * cell_px, 3)``: x in red, y in green, coasted in blue.

    Args:
        displacement_px: ``(m, 2)``, row-major, px.
        coasted: ``(m,)`` True where a marker is predicted.
        grid: Rows and columns of the markers.
        range_px: Displacement that is drawn as the darkest or brightest level, px.
        cell_px: Width of a marker's cell, px.
    """
    share = np.clip(displacement_px / range_px, -1.0, 1.0)
    cells = np.zeros((*grid, 3), np.uint8)
    cells[..., :2] = np.rint(NONE_LEVEL + LEVELS * share).reshape(*grid, 2)
    cells[..., 2] = 255 * coasted.reshape(grid)
    return cells.repeat(cell_px, axis=0).repeat(cell_px, axis=1)
