"""Likeness to fields that were learned: Gaussian bumps around a few hundred of them.

A formula that holds for every contact knows no details of one. Bumps add them where fields were
learned and nothing elsewhere, so what is far from all of them falls back to the formula
(a Gaussian process on inducing points; C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes
for Machine Learning", 2006, section 8.3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]

CENTERS = 400
"""Fields that are remembered (ours: 600 and 1500 give the same errors on data/force)."""
DRAWN_CENTERS = 1_000
"""The same where contacts are drawn, which are of more kinds (ours: 400 err by 0.08 to 0.12 of the
range of the normal force, 1,000 by 0.07 to 0.08)."""
WIDTH = 0.6
"""Standard deviation of a bump, in lengths of a normalised field (ours: 0.4 to 1 are alike)."""
AMPLITUDE_WEIGHT = 0.3
"""Weight of the amplitude's logarithm beside the shape (ours: 0.3; 1 errs more)."""
SMALLEST_EIGENVALUE = 1e-6
"""Directions of the kernel matrix that are not told apart in double precision."""


def coordinates(size: Field, shape: Field) -> Field:
    """Return where fields with amplitudes ``(n,)`` and shapes ``(n, k)`` lie, ``(n, k + 1)``."""
    return np.column_stack([shape, AMPLITUDE_WEIGHT * np.log(size)])


def choose_centers(places: Field, count: int) -> Field:
    """Return so many remembered places, evenly over the training frames ``(n, k + 1)``."""
    rows = np.linspace(0, len(places) - 1, min(count, len(places))).astype(np.int64)
    return places[rows]


def likeness(places: Field, centers: Field, center_squares: Field) -> Field:
    """Return the height of each bump ``(n, c)`` at places ``(n, k + 1)``.

    Args:
        places: Where fields lie.
        centers: ``(c, k + 1)`` remembered places.
        center_squares: ``(c,)`` their squared lengths.
    """
    away = places @ centers.T
    away *= -2.0
    away += center_squares
    away += (places * places).sum(axis=1)[:, None]
    np.maximum(away, 0.0, out=away)
    away *= -0.5 / WIDTH**2
    return np.exp(away, out=away)


def whitening(centers: Field) -> Field:
    """Return ``(c, r)``: bumps times it are features of which equal penalties are a prior."""
    values, vectors = np.linalg.eigh(likeness(centers, centers, (centers**2).sum(axis=1)))
    kept = values > SMALLEST_EIGENVALUE
    return vectors[:, kept] / np.sqrt(values[kept])
