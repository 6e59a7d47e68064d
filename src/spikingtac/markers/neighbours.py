"""Affine prediction of each marker's displacement from those of its nearest neighbours.

The residual of a marker against this prediction is deformation, or the error of one fit. Most of a
skin is nearly affine from marker to marker; a few markers beside a contact are not at all. So a
small residual is more likely an error, a large one never is. A prior with heavy tails says so, and
its estimate is a shrinkage that fades with the residual (empirical Bayes, Carlin and Louis 2000,
doi:10.1201/9781420057669).
"""

import numpy as np

from spikingtac.calibration.lens import distances_px
from spikingtac.kernels import kernel
from spikingtac.state_map.graded import Array
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
        count = len(reference_px)
        self.index = np.zeros((count, max(min(NEIGHBOURS, count - 1), 1)), np.int64)
        self.weight = np.ones(self.index.shape)
        for i in range(count if count > 1 else 0):
            offset = reference_px - reference_px[i]
            order = np.argsort(np.hypot(offset[:, 0], offset[:, 1]), kind="stable")
            self.index[i] = order[order != i][: self.index.shape[1]]
            self.weight[i] = _affine_weights_at_origin(offset[self.index[i]])
        self.arrays = self.reference_px, self.index, self.weight
        self.bound_px = FARTHEST_PITCHES * distances_px(reference_px).min(axis=1, initial=np.inf)
        self.own_share = 1.0 / (1.0 + (self.weight**2).sum(axis=1))

    def expected_px(self, position_px: FloatArray) -> FloatArray:
        """Return ``(m, 2)`` positions that the neighbours predict, px."""
        out = np.empty_like(self.reference_px)
        expect_kernel(position_px, self.arrays, out)
        return out


@kernel(forceinline=True)
def neighbour_range_kernel(
    position_px: Array, neighbours: tuple[Array, Array, Array], m: int, axis: int
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Return the displacement that a marker's neighbours predict, and the range of theirs, px.

    ``neighbours`` holds rest positions, neighbours and their weights.
    """
    reference_px, index, weight = neighbours
    expected, low, high = 0.0, np.inf, -np.inf
    for k in range(index.shape[1]):
        n = index[m, k]
        other = position_px[n, axis] - reference_px[n, axis]
        expected += weight[m, k] * other
        low, high = min(low, other), max(high, other)
    return expected, low, high


@kernel()
def expect_kernel(
    position_px: Array, neighbours: tuple[Array, Array, Array], out: Array
) -> None:  # pragma: no cover - compiled
    """Write the positions that neighbours predict, clipped to the range of their displacements."""
    for m in range(len(out)):
        for axis in range(2):
            moved, low, high = neighbour_range_kernel(position_px, neighbours, m, axis)
            out[m, axis] = neighbours[0][m, axis] + min(max(moved, low), high)


def _affine_weights_at_origin(points: FloatArray) -> FloatArray:
    spread = max(float(np.sqrt((points**2).mean())), 1e-9)
    design = np.column_stack([np.ones(len(points)), points / spread])
    ridge = np.diag([0.0, RIDGE * len(points), RIDGE * len(points)])
    weights = np.linalg.solve(design.T @ design + ridge, design.T)[0]
    return np.round(weights / weights.sum(), WEIGHT_DECIMALS)


def smallest_spacing_px(reference_px: FloatArray) -> float:
    """Return the smallest distance between two markers, px; infinite for a single marker."""
    return float(distances_px(reference_px).min(initial=np.inf))
