"""The touched part of the skin: its centre, area and outline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]


SQUARE = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
"""Corners of a square about its centre, in its sides."""


@dataclass(frozen=True, slots=True)
class Patch:
    """A touched part of the skin, in the markers' unit.

    Attributes:
        place: ``(2,)`` its centre.
        area: Area within its outline.
        outline: ``(k, 2)`` its convex outline.
    """

    place: Field
    area: float
    outline: Field


def patch_of_cells(corners: Field, weights: Field) -> Patch:
    """Return the patch that cells make up.

    Args:
        corners: ``(c, 4, 2)`` corners of each cell; at least one cell.
        weights: ``(c,)`` how surely each is touched; they weigh the centre.
    """
    # A late import: every verb's start would wait for it.
    from scipy.spatial import ConvexHull

    points = corners.reshape(-1, 2)
    hull = ConvexHull(points)
    place = weights @ corners.mean(axis=1) / weights.sum()
    return Patch(place, float(hull.volume), points[hull.vertices])  # in a plane, its area
