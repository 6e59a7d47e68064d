"""Where a deformed skin is touched: centre, area and outline from the gradients at the markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]

HALF = 0.5
"""Share of the largest strength that belongs to the patch."""


@dataclass(frozen=True, slots=True)
class Patch:
    """A deformed region.

    Attributes:
        place: ``(2,)`` its centre, in the markers' unit.
        area: Its area, in that unit squared.
        outline: ``(k, 2)`` its convex outline.
    """

    place: Field
    area: float
    outline: Field


def deformed_patch(reference: Field, strength: Field) -> Patch:
    """Return the region whose strength is at least half of the largest.

    Each marker stands for its share of the skin; the area counts the markers' shares, so it is
    right to about one share, and no smaller than one.

    Args:
        reference: ``(m, 2)`` markers at rest.
        strength: ``(m,)`` what is felt at each, not negative.
    """
    largest = float(strength.max(initial=0.0))
    weight = np.where(strength >= HALF * largest, strength, 0.0) if largest > 0 else strength + 1.0
    inside = weight > 0.0
    place = weight @ reference / weight.sum()
    return Patch(place, _share(reference) * int(inside.sum()), _outline(reference[inside]))


def _share(reference: Field) -> float:
    """Return the area of skin that one marker stands for: its Voronoi share, from the pitch."""
    away = ((reference[:, None] - reference[None]) ** 2).sum(axis=2)
    np.fill_diagonal(away, np.inf)
    return float(np.median(away.min(axis=1)))


def _outline(places: Field) -> Field:
    if len(places) < 3:
        return places.copy()
    # A late import: every verb's start would wait for it.
    from scipy.spatial import ConvexHull, QhullError

    try:
        return places[ConvexHull(places).vertices]
    except QhullError:  # all on one line
        return places.copy()
