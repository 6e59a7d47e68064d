"""Displacement and its gradient at the markers, from a periodic grid."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.arrays import FloatArray
from spikingtac.sim.gel.greens import GridConfig

_STENCIL = np.arange(-2, 4)


@njit(cache=True, nogil=True)
def interpolate_kernel(
    fields: FloatArray, cells: NDArray[np.int64], weights: FloatArray, found: FloatArray
) -> None:
    """Add up weighted cells: ``found[f, w, m] += sum_s weights[w, m, s] fields[f, cells[m, s]]``.

    Args:
        fields: ``(f, n²)`` values on the grid.
        cells: ``(m, s)`` flat index of each marker's cells.
        weights: ``(w, m, s)`` weights of those cells.
        found: ``(f, w, m)`` sums, added to.
    """
    for marker in range(cells.shape[0]):
        for near in range(cells.shape[1]):
            cell = cells[marker, near]
            for weight in range(weights.shape[0]):
                factor = weights[weight, marker, near]
                for part in range(fields.shape[0]):
                    found[part, weight, marker] += factor * fields[part, cell]


class MarkerInterpolation:
    """Quintic Lagrange interpolation on 6 by 6 cells. The weights are computed once.

    Args:
        grid: The grid.
        points_mm: ``(m, 2)`` points (x, y), mm. The grid repeats beyond its span.
    """

    def __init__(self, grid: GridConfig, points_mm: FloatArray) -> None:
        scaled = (points_mm - grid.axis_mm[0]) / grid.pitch_mm
        base = np.floor(scaled).astype(np.int64)
        values, slopes = _lagrange(scaled - base)
        columns = (base[:, 0, None] + _STENCIL) % grid.cells
        rows = (base[:, 1, None] + _STENCIL) % grid.cells
        self._cells = (rows[:, :, None] * grid.cells + columns[:, None, :]).reshape(len(base), -1)
        outer = "mi,mj->mij"
        weights = [
            np.einsum(outer, values[:, 1], values[:, 0]),
            np.einsum(outer, values[:, 1], slopes[:, 0]) / grid.pitch_mm,
            np.einsum(outer, slopes[:, 1], values[:, 0]) / grid.pitch_mm,
        ]
        self._weights = np.stack(weights).reshape(3, len(base), -1)

    def at_markers(self, displacement_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return displacement and in-plane gradient at the points.

        Args:
            displacement_mm: ``(3, n, n)`` field, mm.

        Returns:
            ``(m, 3)`` displacement, mm, and ``(m, 2, 2)`` derivatives d(u_x, u_y) / d(x, y).
        """
        found = np.zeros((3, 3, len(self._cells)))
        interpolate_kernel(displacement_mm.reshape(3, -1), self._cells, self._weights, found)
        moved = np.ascontiguousarray(found[:, 0].T)
        return moved, np.ascontiguousarray(found[:2, 1:].transpose(2, 0, 1))


def _lagrange(fraction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weights (and their slopes) of the stencil at fractions of a cell."""
    values = np.ones((*fraction.shape, len(_STENCIL)))
    slopes = np.zeros_like(values)
    for i, node in enumerate(_STENCIL):
        for other in _STENCIL[node != _STENCIL]:
            factor = (fraction - other) / (node - other)
            slopes[..., i] = slopes[..., i] * factor + values[..., i] / (node - other)
            values[..., i] *= factor
    return values, slopes
