"""Dense influence matrices between the few cells in contact.

A contact covers 2 to 10 % of the grid. A dense product over its own cells takes less time than a
Fourier transform of the whole grid, and the results are equal. Single precision halves the memory
that each product reads, which limits its speed. Its rounding (1e-7 of a displacement) is far below
the tolerance of the iterations. Products are written as loops: BLAS would start its threads, which
takes longer than the product and makes the last digits depend on the number of cores.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

SingleMatrix = NDArray[np.float32]
SingleVector = NDArray[np.float32]
Cells = NDArray[np.int64]

# Rows that are added beyond need when the matrices grow, so that they grow seldom.
SPARE_CAPACITY = 64


@njit(cache=True, nogil=True)
def fill_influence_kernel(
    unrolled: SingleMatrix, cell_index: Cells, slots: Cells, center: int, out: NDArray[np.float32]
) -> None:
    """Write the rows and columns of some slots: ``out[t, i, j]`` is the response at i to j.

    Args:
        unrolled: ``(tables, (2n - 1)²)`` response by offset, without wrap-around.
        cell_index: ``(c,)`` index of each slot's cell in rows of 2n - 1.
        slots: Slots whose cell is new.
        center: Index of the offset zero.
        out: ``(tables, capacity, capacity)`` matrices, with capacity >= c.
    """
    for table in range(out.shape[0]):
        for slot in slots:
            for other in range(len(cell_index)):
                offset = cell_index[slot] - cell_index[other]
                out[table, slot, other] = unrolled[table, center + offset]
                out[table, other, slot] = unrolled[table, center - offset]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, forceinline=True)
def product_kernel(matrix: SingleMatrix, vector: SingleVector) -> SingleVector:
    """Return the product of a matrix's leading square with a vector.

    Args:
        matrix: ``(capacity, capacity)``.
        vector: ``(c,)`` with c <= capacity.
    """
    count = len(vector)
    out = np.empty(count, np.float32)
    for i in range(count):
        total = np.float32(0.0)
        for j in range(count):
            total += matrix[i, j] * vector[j]
        out[i] = total
    return out


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def lateral_displacement_kernel(
    xx: SingleMatrix, xy: SingleMatrix, yy: SingleMatrix, shear: NDArray[np.float32]
) -> SingleMatrix:
    """Return the ``(2, c)`` lateral displacement under ``(2, c)`` shear.

    Args:
        xx: ``(capacity, capacity)`` displacement along x per shear along x.
        xy: ``(capacity, capacity)`` along x per shear along y, and the other way round.
        yy: ``(capacity, capacity)`` along y per shear along y.
        shear: ``(2, c)``.
    """
    count = shear.shape[1]
    out = np.empty((2, count), np.float32)
    for i in range(count):
        along_x = np.float32(0.0)
        along_y = np.float32(0.0)
        for j in range(count):
            along_x += xx[i, j] * shear[0, j] + xy[i, j] * shear[1, j]
            along_y += xy[i, j] * shear[0, j] + yy[i, j] * shear[1, j]
        out[0, i] = along_x
        out[1, i] = along_y
    return out


class Influence:
    """Influence matrices of a changing set of cells, from the tables of one or more layers.

    Attributes:
        cells: ``(c,)`` flat index of the cell in each slot.
        matrices: ``(tables, capacity, capacity)`` response at each slot to unit traction at each
            other. Only the leading c by c parts hold values.
    """

    def __init__(self, tables: NDArray[np.float64]) -> None:
        """Take the ``(tables, n, n)`` responses by offset ``[dy, dx]`` modulo n."""
        n = tables.shape[-1]
        offsets = np.arange(1 - n, n) % n
        unrolled = tables[:, offsets[:, None], offsets[None, :]].astype(np.float32)
        self._side, self._stride = n, 2 * n - 1
        self._unrolled = np.ascontiguousarray(unrolled.reshape(len(tables), -1))
        self.cells: Cells = np.empty(0, np.int64)
        self.matrices = np.empty((len(tables), 0, 0), np.float32)

    def clear(self) -> None:
        """Empty the set. The memory is kept."""
        self.cells = np.empty(0, np.int64)

    def set_cells(self, wanted: NDArray[np.bool_]) -> None:
        """Change the set of cells. Cells that remain keep their slots where possible.

        Args:
            wanted: ``(n²,)`` True for the cells of the set.
        """
        stays = wanted[self.cells]
        fresh = wanted.copy()
        fresh[self.cells] = False
        incoming = np.flatnonzero(fresh)
        count = int(stays.sum()) + len(incoming)
        if len(incoming) == 0 and count == len(self.cells):
            return
        slots = np.full(count, -1)
        low = self.cells[:count]
        slots[: len(low)] = np.where(stays[: len(low)], low, -1)
        moved = self.cells[count:][stays[count:]]
        empty = np.flatnonzero(slots < 0)
        slots[empty] = np.concatenate((moved, incoming))
        self.cells = slots
        self._fill(empty)

    def _fill(self, slots: Cells) -> None:
        capacity = self.matrices.shape[1]
        if len(self.cells) > capacity:
            capacity = len(self.cells) + SPARE_CAPACITY
            self.matrices = np.empty((len(self._unrolled), capacity, capacity), np.float32)
            slots = np.arange(len(self.cells))
        rows, columns = np.divmod(self.cells, self._side)
        center = (self._stride // 2) * (self._stride + 1)
        cell_index = rows * self._stride + columns
        fill_influence_kernel(self._unrolled, cell_index, slots, center, self.matrices)
