"""Affine prediction of each marker's displacement from those of its nearest neighbours.

The residual of a marker against this prediction is deformation, or the error of one fit. Most of a
skin is nearly affine from marker to marker; a few markers beside a contact are not at all. So a
small residual is more likely an error, a large one never is. A prior with heavy tails says so, and
its estimate is a shrinkage that fades with the residual (empirical Bayes, Carlin and Louis 2000,
doi:10.1201/9781420057669).
"""

import numpy as np

from spikingtac.calibration.lens import distances_px
from spikingtac.types import FloatArray

NEIGHBOURS = 8  # Neighbours of a marker: the ring around it in a square grid.

# Decimals to which weights are rounded: linear algebra differs between processors in about the
# fifteenth (1e-7 px of error on a sensor of 320 px).
WEIGHT_DECIMALS = 9

# Regularises the affine fit where the neighbours lie on a line, relative to their spread.
RIDGE = 1e-3

# How far a displacement may leave the range of its neighbours' displacements, in distances to the
# nearest neighbour. A gel hardly stretches more between two markers (at most 0.15 in every
# recording with truth, twisted by a finger; 0.14 on the recorded gel).
FARTHEST_PITCHES = 0.25


class Neighbourhood:
    """Predicts the displacement of each marker from those of its nearest neighbours.

    Attributes:
        reference_px: ``(m, 2)`` rest positions, px.
        index: ``(m, k)`` int64 neighbours of each marker.
        weight: ``(m, k)`` their weights, which sum to 1 per marker.
        arrays: Rest positions, index and weight: what kernels take.
        own_share: ``(m,)`` share of a residual's variance that is the marker's own error.
        bound_px: ``(m,)`` largest distance from the range of the neighbours' displacements, px.
    """

    def __init__(self, reference_px: FloatArray) -> None:
        """Solve the weights once; a marker without neighbours predicts itself.

        Args:
            reference_px: ``(m, 2)`` rest positions, px.
        """
        self.reference_px = np.ascontiguousarray(reference_px, np.float64)
        away_px = distances_px(self.reference_px)
        count = max(min(NEIGHBOURS, len(away_px) - 1), 1)
        self.index = np.argsort(away_px, axis=1, kind="stable")[:, :count]
        self.weight = _affine_weights(self.reference_px[self.index] - self.reference_px[:, None])
        self.arrays = self.reference_px, self.index, self.weight
        self.bound_px = FARTHEST_PITCHES * away_px.min(axis=1)
        self.own_share = 1.0 / (1.0 + (self.weight**2).sum(axis=1))

    def expected_px(self, position_px: FloatArray) -> FloatArray:
        """Return ``(m, 2)`` positions that the neighbours predict, px.

        They are clipped to the range of the neighbours' displacements.
        """
        around_px = (position_px - self.reference_px)[self.index]
        moved_px = (self.weight[..., np.newaxis] * around_px).sum(axis=1)
        return self.reference_px + moved_px.clip(around_px.min(axis=1), around_px.max(axis=1))


def _affine_weights(offset_px: FloatArray) -> FloatArray:
    spread_px = np.sqrt((offset_px**2).mean(axis=(1, 2), keepdims=True)).clip(1e-9)
    design = np.concatenate([np.ones_like(offset_px[..., :1]), offset_px / spread_px], axis=2)
    ridge, across = RIDGE * offset_px.shape[1] * np.diag([0.0, 1.0, 1.0]), design.swapaxes(1, 2)
    weights = np.linalg.solve(across @ design + ridge, across)[:, 0]
    return np.round(weights / weights.sum(axis=1, keepdims=True), WEIGHT_DECIMALS)


def smallest_spacing_px(reference_px: FloatArray) -> float:
    """Return the smallest distance between two markers, px; infinite for a single marker."""
    return float(distances_px(reference_px).min(initial=np.inf))
