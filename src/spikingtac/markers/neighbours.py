"""Where a marker's neighbours expect it: an affine map of the nearest rest positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NEIGHBOURS = 8
"""Markers that vote on one: the ring around it in a square grid."""

RIDGE = 1e-3
"""Regularises the affine fit where the neighbours lie on a line, relative to their spread."""


def neighbour_weights(reference_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix that predicts each displacement from the others.

    Row i holds the weights of an affine least-squares fit of the displacements of the nearest
    markers, evaluated at marker i; every row sums to 1 and its diagonal is 0.

    Args:
        reference_px: ``(m, 2)`` rest positions, px.

    Returns:
        ``(m, m)`` weights; a marker without neighbours predicts itself.
    """
    count = len(reference_px)
    weights = np.zeros((count, count))
    for i in range(count):
        offset = reference_px - reference_px[i]
        order = np.argsort(np.hypot(offset[:, 0], offset[:, 1]), kind="stable")
        near = order[order != i][:NEIGHBOURS]
        if len(near):
            weights[i, near] = _affine_weights_at_origin(offset[near])
        else:
            weights[i, i] = 1.0
    return weights


def _affine_weights_at_origin(points: NDArray[np.float64]) -> NDArray[np.float64]:
    spread = max(float(np.sqrt((points**2).mean())), 1e-9)
    design = np.column_stack([np.ones(len(points)), points / spread])
    ridge = np.diag([0.0, RIDGE * len(points), RIDGE * len(points)])
    weights = np.linalg.solve(design.T @ design + ridge, design.T)[0]
    return weights / weights.sum()


def smallest_spacing_px(reference_px: NDArray[np.float64]) -> float:
    """Return the smallest distance between two markers, px; infinite for a single marker."""
    offset = reference_px[:, np.newaxis] - reference_px[np.newaxis]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    np.fill_diagonal(distance, np.inf)
    return float(distance.min(initial=np.inf))
