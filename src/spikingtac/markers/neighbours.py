"""Where a marker's neighbours expect it: an affine map of the nearest rest positions.

What a marker differs from it is deformation, or an error of one fit. Most of a skin is nearly
affine from marker to marker, and a few markers beside a contact are not at all: a small difference
is more likely an error, a large one never is. A prior with heavy tails says so, and its estimate
is shrinkage that fades with the difference (empirical Bayes, Carlin and Louis 2000,
doi:10.1201/9781420057669).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

NEIGHBOURS = 8
"""Markers that vote on one: the ring around it in a square grid."""

WEIGHT_DECIMALS = 9
"""Decimals of a weight: linear algebra differs between processors in the fifteenth or so, and what
is rounded off is the same everywhere (ours: 1e-7 px of error on a sensor of 320 px)."""
TINY_PX2 = 1e-12
"""Square of a difference, px^2, that is none: two zeros are not divided."""

RIDGE = 1e-3
"""Regularises the affine fit where the neighbours lie on a line, relative to their spread."""

FARTHEST_PITCHES = 0.25
"""How far a displacement may leave the range of its neighbours' displacements, in distances to the
nearest neighbour. A gel hardly stretches more between two markers (ours: at most 0.15 in every
recording with truth, twisted by a finger; 0.14 on the recorded gel)."""


class Neighbourhood:
    """Predicts the displacement of each marker from those of its nearest neighbours.

    Attributes:
        index: ``(m, k)`` int64 neighbours of each marker.
        weight: ``(m, k)`` their weights, which sum to 1 per marker.
        bound_px: ``(m,)`` farthest from the range of the neighbours' displacements, px.
    """

    def __init__(self, reference_px: NDArray[np.float64]) -> None:
        """Solve the weights once; a marker without neighbours predicts itself.

        Args:
            reference_px: ``(m, 2)`` rest positions, px.
        """
        self._reference_px = np.ascontiguousarray(reference_px, np.float64)
        count = len(reference_px)
        self.index = np.zeros((count, max(min(NEIGHBOURS, count - 1), 1)), np.int64)
        self.weight = np.ones(self.index.shape)
        for i in range(count if count > 1 else 0):
            offset = reference_px - reference_px[i]
            order = np.argsort(np.hypot(offset[:, 0], offset[:, 1]), kind="stable")
            self.index[i] = order[order != i][: self.index.shape[1]]
            self.weight[i] = _affine_weights_at_origin(offset[self.index[i]])
        self.bound_px = FARTHEST_PITCHES * nearest_px(self._reference_px)
        # Of the variance of a difference, a marker's own part; the rest is the prediction's.
        self._own_share = 1.0 / (1.0 + (self.weight**2).sum(axis=1))

    def expected_px(self, position_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``(m, 2)`` where the neighbours of each marker expect it, px."""
        out = np.empty_like(self._reference_px)
        _expect_kernel(position_px, self._reference_px, self.index, self.weight, out)
        return out

    def bounded_px(
        self, position_px: NDArray[np.float64], place_px: NDArray[np.float64], bound_px: float
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return places moved to where the neighbours allow them, and which ones were outside.

        Args:
            position_px: ``(m, 2)`` where the neighbours are, px.
            place_px: ``(m, 2)`` places that are looked at, px; they are not changed.
            bound_px: How far a displacement may leave the range of the neighbours', as a share of
                :attr:`bound_px`.
        """
        out, outside = place_px.copy(), np.zeros(len(place_px), np.bool_)
        _bound_kernel(
            position_px, self._reference_px, self.index, bound_px * self.bound_px, out, outside
        )
        return out, outside

    def shrunk_px(
        self, position_px: NDArray[np.float64], noise_px: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the markers with their differences from the neighbours' prediction shrunk.

        A difference r shrinks by its share noise^2 / (r^2 + noise^2), of which the marker takes
        the part that its own error has in it: 0.9 amid eight neighbours, 0.6 in a corner. One far
        above the noise stays, and none changes by more than half of the noise.

        Args:
            position_px: ``(m, 2)`` where the markers were found, px.
            noise_px: ``(m,)`` differences that are as likely an error as deformation, px.
        """
        out = self.expected_px(position_px)
        _shrink_kernel(position_px, noise_px, self._own_share, out)
        return out


@njit(cache=True, nogil=True)
def _expect_kernel(
    position_px: NDArray[np.float64],
    reference_px: NDArray[np.float64],
    index: NDArray[np.int64],
    weight: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    for m in range(index.shape[0]):
        x, y = reference_px[m, 0], reference_px[m, 1]
        for k in range(index.shape[1]):
            n = index[m, k]
            x += weight[m, k] * (position_px[n, 0] - reference_px[n, 0])
            y += weight[m, k] * (position_px[n, 1] - reference_px[n, 1])
        out[m, 0], out[m, 1] = x, y


@njit(cache=True, nogil=True)
def _bound_kernel(
    position_px: NDArray[np.float64],
    reference_px: NDArray[np.float64],
    index: NDArray[np.int64],
    bound_px: NDArray[np.float64],
    place_px: NDArray[np.float64],
    outside: NDArray[np.bool_],
) -> None:  # pragma: no cover - compiled
    """Move each place to the nearest one within the bound of its neighbours' displacements."""
    for m in range(index.shape[0]):
        out_px = np.zeros(2)
        for axis in range(2):
            low, high = np.inf, -np.inf
            for k in range(index.shape[1]):
                moved = position_px[index[m, k], axis] - reference_px[index[m, k], axis]
                low, high = min(low, moved), max(high, moved)
            moved = place_px[m, axis] - reference_px[m, axis]
            out_px[axis] = moved - min(max(moved, low), high)
        length = np.hypot(out_px[0], out_px[1])
        outside[m] = length > bound_px[m]
        if outside[m]:
            for axis in range(2):
                place_px[m, axis] -= (1.0 - bound_px[m] / length) * out_px[axis]


@njit(cache=True, nogil=True)
def _shrink_kernel(
    position_px: NDArray[np.float64],
    noise_px: NDArray[np.float64],
    own_share: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Move the expected places in ``out`` to where the markers are, but for errors of the fits."""
    for m in range(out.shape[0]):
        x, y = position_px[m, 0] - out[m, 0], position_px[m, 1] - out[m, 1]
        noise2 = noise_px[m] * noise_px[m] + TINY_PX2
        kept = 1.0 - own_share[m] * noise2 / (x * x + y * y + noise2)
        out[m, 0] += kept * x
        out[m, 1] += kept * y


def _affine_weights_at_origin(points: NDArray[np.float64]) -> NDArray[np.float64]:
    spread = max(float(np.sqrt((points**2).mean())), 1e-9)
    design = np.column_stack([np.ones(len(points)), points / spread])
    ridge = np.diag([0.0, RIDGE * len(points), RIDGE * len(points)])
    weights = np.linalg.solve(design.T @ design + ridge, design.T)[0]
    return np.round(weights / weights.sum(), WEIGHT_DECIMALS)


def nearest_px(reference_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(m,)`` the distance of each marker from the nearest other, px; infinite for one."""
    offset = reference_px[:, np.newaxis] - reference_px[np.newaxis]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance.min(axis=1, initial=np.inf))


def smallest_spacing_px(reference_px: NDArray[np.float64]) -> float:
    """Return the smallest distance between two markers, px; infinite for a single marker."""
    return float(nearest_px(reference_px).min(initial=np.inf))
