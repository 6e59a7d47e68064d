"""Likeness to fields that were learned: Gaussian bumps around some hundreds of them.

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
"""The same where contacts are drawn, which are of more kinds (ours: 600 err by 4.6 % of the range
of the normal force on eight scenes that are not scored, 1,000 by 4.2 %, 1,500 by 4.0 %)."""
MOST_CANDIDATES = 8_000
"""Fields among which they are chosen, evenly over those that were learned from."""
LEAST_VARIANCE = 1e-6
"""Share of a field's prior variance below which the others say all of it."""
WIDTH = 0.6
"""Standard deviation of a bump, in lengths of a normalised field (ours: 0.4 to 1 are alike)."""
AMPLITUDE_WEIGHT = 0.3
"""Weight of the amplitude's logarithm beside the shape (ours: 0.3; 1 errs more)."""
SMALLEST_EIGENVALUE = 1e-6
"""Directions of the kernel matrix that are not told apart in double precision."""


def coordinates(size: Field, shape: Field) -> Field:
    """Return where fields with amplitudes ``(n,)`` and shapes ``(n, k)`` lie, ``(n, k + 1)``."""
    return np.column_stack([shape, AMPLITUDE_WEIGHT * np.log(size)])


def evenly_chosen(places: Field, count: int) -> Field:
    """Return so many of the places ``(n, k + 1)``, at most, evenly over the training frames."""
    rows = np.linspace(0, len(places) - 1, min(count, len(places))).astype(np.int64)
    return places[rows]


def unlike_ones(places: Field, count: int) -> Field:
    """Return so many of the places ``(n, k + 1)``, at most, each unlike all the others.

    One after another, each time the field of which those before say least: pivoted Cholesky
    decomposition of the likenesses (S. Fine, K. Scheinberg, "Efficient SVM Training Using Low-Rank
    Kernel Representations", JMLR 2, 2001), which D. R. Burt and others ("Convergence of Sparse
    Variational Inference in Gaussian Processes Regression", JMLR 21, 2020) recommend. For drawn
    contacts; of recorded frames the most unlike are the worst measured (ours: 0.872 instead of
    0.880 of the normal force's variance on data/force, with depth).
    """
    candidates = evenly_chosen(places, MOST_CANDIDATES)
    squares = (candidates * candidates).sum(axis=1)
    factor = np.empty((min(count, len(candidates)), len(candidates)))
    left, chosen = np.ones(len(candidates)), []
    for row in factor:
        pivot = int(left.argmax())
        if left[pivot] < LEAST_VARIANCE:
            break
        known = factor[: len(chosen)]
        row[:] = likeness(candidates, candidates[[pivot]], squares[[pivot]])[:, 0]
        row -= known[:, pivot] @ known
        row /= np.sqrt(left[pivot])
        left -= row * row
        chosen.append(pivot)
    return candidates[chosen]


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
