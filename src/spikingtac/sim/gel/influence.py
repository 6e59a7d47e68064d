"""Dense influence matrices between the few cells that touch.

A contact covers 2 to 10 % of the grid, so the contact problem is solved on its own cells, where a
dense product costs less than a Fourier transform of the whole grid; results are equal. Single
precision halves the memory that each product reads, which is what limits it; its rounding (1e-7 of
a displacement) is far below the tolerance of the iterations. Products are written out, since BLAS
would wake its threads for them, which costs more than the product and lets the last digits depend
on the machine's cores.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Matrix = NDArray[np.float32]
Vector = NDArray[np.float32]
Cells = NDArray[np.int64]

SPARE_SLOTS = 64
"""Rows that are added beyond need when the memory grows, so that it seldom grows."""


@njit(cache=True, nogil=True)
def refill_kernel(
    unrolled: Matrix, places: Cells, slots: Cells, center: int, out: NDArray[np.float32]
) -> None:
    """Write the rows and columns of some slots: ``out[t, i, j]`` is the response at i to j.

    Args:
        unrolled: ``(tables, (2n - 1)²)`` response by offset, without wrap-around.
        places: ``(c,)`` place of each slot's cell in rows of 2n - 1.
        slots: Slots whose cell is new.
        center: Index of the offset zero.
        out: ``(tables, room, room)`` matrices, room >= c.
    """
    for table in range(out.shape[0]):
        for slot in slots:
            for other in range(len(places)):
                offset = places[slot] - places[other]
                out[table, slot, other] = unrolled[table, center + offset]
                out[table, other, slot] = unrolled[table, center - offset]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def product_kernel(matrix: Matrix, vector: Vector) -> Vector:
    """Return the product of a matrix's leading square with a vector.

    Args:
        matrix: ``(room, room)``.
        vector: ``(c,)`` with c <= room.
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
def sheared_kernel(xx: Matrix, xy: Matrix, yy: Matrix, shear: NDArray[np.float32]) -> Matrix:
    """Return the ``(2, c)`` lateral displacement under ``(2, c)`` shear.

    Args:
        xx: ``(room, room)`` displacement along x per shear along x.
        xy: ``(room, room)`` along x per shear along y, and the other way round.
        yy: ``(room, room)`` along y per shear along y.
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
        matrices: ``(tables, room, room)`` response at each slot to unit traction on each other;
            only the leading c by c parts hold values.
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
        """Empty the set; the memory stays."""
        self.cells = np.empty(0, np.int64)

    def choose(self, wanted: NDArray[np.bool_]) -> None:
        """Change the set of cells; those that stay keep their slots where they can.

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
        self._refill(empty)

    def _refill(self, slots: Cells) -> None:
        room = self.matrices.shape[1]
        if len(self.cells) > room:
            room = len(self.cells) + SPARE_SLOTS
            self.matrices = np.empty((len(self._unrolled), room, room), np.float32)
            slots = np.arange(len(self.cells))
        rows, columns = np.divmod(self.cells, self._side)
        center = (self._stride // 2) * (self._stride + 1)
        places = rows * self._stride + columns
        refill_kernel(self._unrolled, places, slots, center, self.matrices)
