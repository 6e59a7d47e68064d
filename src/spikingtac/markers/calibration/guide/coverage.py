"""How much of each marker's disc has been seen to change, and on which side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SIDES = ("right", "left", "lower", "upper")
"""Quarters of a disc, in the order of :attr:`Coverage.sides`."""

OPPOSITE = ("left", "right", "up", "down")
"""The way that a marker must go and come back from, to uncover each of :data:`SIDES`."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """What is known of the discs.

    Attributes:
        share: ``(m,)`` share of each disc's pixels that swung from ground to marker; all of them
            have once the marker has moved by its diameter, whichever way.
        sides: ``(m, 4)`` the same for its right, left, lower and upper quarter.
    """

    share: NDArray[np.float64]
    sides: NDArray[np.float64]


def coverage(
    swung: NDArray[np.bool_], center_px: NDArray[np.float64], radius_px: float
) -> Coverage:
    """Measure the discs of a grid.

    Args:
        swung: ``(height, width)`` which pixels swung.
        center_px: ``(m, 2)`` where the markers rest, px; discs may reach over the border.
        radius_px: Their radius, px.

    Example:
        >>> seen = np.zeros((9, 9), bool)
        >>> seen[:, 5:] = True  # the right half of a disc in the middle
        >>> coverage(seen, np.array([[4.0, 4.0]]), 3.0).sides.tolist()
        [[1.0, 0.0, 0.4, 0.4]]
    """
    reach = int(np.ceil(radius_px)) + 1
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    nearest = np.rint(center_px).astype(np.int64)
    column = nearest[:, 0, np.newaxis] + x.ravel()
    row = nearest[:, 1, np.newaxis] + y.ravel()
    dx, dy = column - center_px[:, :1], row - center_px[:, 1:]
    height, width = swung.shape
    inside = (np.hypot(dx, dy) <= radius_px) & (column >= 0) & (row >= 0)
    inside &= (column < width) & (row < height)
    seen = inside & swung[row.clip(0, height - 1), column.clip(0, width - 1)]
    across = np.abs(dx) > np.abs(dy)
    quarters = (across & (dx > 0), across & (dx < 0), ~across & (dy > 0), ~across & (dy < 0))
    sides = np.column_stack([_share(seen & part, inside & part) for part in quarters])
    return Coverage(_share(seen, inside), sides)


def _share(seen: NDArray[np.bool_], of: NDArray[np.bool_]) -> NDArray[np.float64]:
    return seen.sum(axis=1) / np.maximum(of.sum(axis=1), 1)
