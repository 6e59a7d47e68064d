"""Displacement and its gradient at the markers, from a periodic grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from spikingtac.sim.greens import GridConfig

Field = NDArray[np.float64]

_STENCIL = np.arange(-2, 4)


class MarkerInterpolation:
    """Quintic Lagrange interpolation on 6 by 6 cells, with weights made once.

    Args:
        grid: The grid.
        points_mm: ``(m, 2)`` where to interpolate (x, y), mm; the grid repeats beyond its span.
    """

    def __init__(self, grid: GridConfig, points_mm: Field) -> None:
        scaled = (points_mm - grid.axis_mm[0]) / grid.pitch_mm
        base = np.floor(scaled).astype(np.int64)
        values, slopes = _lagrange(scaled - base)
        columns = (base[:, 0, None] + _STENCIL) % grid.cells
        rows = (base[:, 1, None] + _STENCIL) % grid.cells
        cells = (rows[:, :, None] * grid.cells + columns[:, None, :]).ravel()
        outer = "mi,mj->mij"
        weights = [
            np.einsum(outer, values[:, 1], values[:, 0]),
            np.einsum(outer, values[:, 1], slopes[:, 0]) / grid.pitch_mm,
            np.einsum(outer, slopes[:, 1], values[:, 0]) / grid.pitch_mm,
        ]
        starts = np.arange(3 * len(base) + 1) * len(_STENCIL) ** 2
        shape = (3 * len(base), grid.cells**2)
        parts = (np.concatenate(weights).ravel(), np.tile(cells, 3), starts)
        self._weights = csr_array(parts, shape=shape)

    def at_markers(self, displacement_mm: Field) -> tuple[Field, Field]:
        """Return displacement and in-plane gradient at the points.

        Args:
            displacement_mm: ``(3, n, n)`` field, mm.

        Returns:
            ``(m, 3)`` displacement, mm, and ``(m, 2, 2)`` derivatives d(u_x, u_y) / d(x, y).
        """
        x, y, z = (self._weights @ part.ravel() for part in displacement_mm)
        x, y, z = (part.reshape(3, -1) for part in (x, y, z))
        gradient = np.stack((x[1:], y[1:])).transpose(2, 0, 1)
        return np.column_stack((x[0], y[0], z[0])), gradient


def _lagrange(fraction: Field) -> tuple[Field, Field]:
    """Return the weights (and their slopes) of the stencil at fractions of a cell."""
    values = np.ones((*fraction.shape, len(_STENCIL)))
    slopes = np.zeros_like(values)
    for i, node in enumerate(_STENCIL):
        for other in _STENCIL[node != _STENCIL]:
            factor = (fraction - other) / (node - other)
            slopes[..., i] = slopes[..., i] * factor + values[..., i] / (node - other)
            values[..., i] *= factor
    return values, slopes
