"""Dense influence matrices between the few cells that touch.

A contact covers 2 to 10 % of the grid, so the contact problem is solved on its own cells, where a
dense product costs less than a Fourier transform of the whole grid; results are equal. Single
precision halves the memory that each product reads, which is what limits it; its rounding (1e-7 of
a displacement) is far below the tolerance of the iterations.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Matrices = NDArray[np.float32]


@njit(cache=True)
def influence_kernel(
    mirrored: NDArray[np.float32],
    places: NDArray[np.int64],
    runs: NDArray[np.int64],
    center: int,
    out: NDArray[np.float32],
) -> None:
    """Fill ``out[i, j] = mirrored[places[j] - places[i] + center]``, run by run.

    Args:
        mirrored: ``((2n - 1)²,)`` response by offset from the cell that moves to the cell that is
            loaded, without wrap-around.
        places: ``(c,)`` place of each cell in rows of 2n - 1, increasing.
        runs: Index of the first cell of each run of neighbours, then c.
        center: Index of the offset zero.
        out: ``(c, c)`` matrix to fill.
    """
    for i in range(len(places)):
        base = center - places[i]
        for run in range(len(runs) - 1):
            first = runs[run]
            source = base + places[first]
            # Contiguous on both sides, so that the copy is vectorised.
            for step in range(runs[run + 1] - first):
                out[i, first + step] = mirrored[source + step]


class Influence:
    """Makes influence matrices from the tables of one layer, or of two in series."""

    def __init__(self, tables: NDArray[np.float64]) -> None:
        n = tables.shape[-1]
        offsets = np.arange(n - 1, -n, -1) % n
        self._stride = 2 * n - 1
        mirrored = tables[:, offsets[:, None], offsets[None, :]].astype(np.float32)
        self._mirrored = np.ascontiguousarray(mirrored.reshape(len(tables), -1))
        self._memory = np.empty(0, np.float32)

    def matrices(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Matrices:
        """Return the ``(tables, c, c)`` response at each cell to unit traction on each other.

        Args:
            rows: ``(c,)`` row of each cell; cells in the grid's order.
            columns: ``(c,)`` column of each cell.

        Returns:
            The matrices, in memory that the next call overwrites.
        """
        places = rows * self._stride + columns
        breaks = np.flatnonzero(np.diff(places) != 1) + 1
        runs = np.concatenate(([0], breaks, [len(places)]))
        center = (self._stride // 2) * (self._stride + 1)
        out = self._reserve(len(self._mirrored), len(rows))
        for table, matrix in zip(self._mirrored, out, strict=True):
            influence_kernel(table, places, runs, center, matrix)
        return out

    def _reserve(self, matrices: int, cells: int) -> Matrices:
        # Fresh memory of this size costs more page faults than the copy costs time.
        size = matrices * cells * cells
        if size > len(self._memory):
            self._memory = np.empty(2 * size, np.float32)
        return self._memory[:size].reshape(matrices, cells, cells)
