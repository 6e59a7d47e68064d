"""Influence matrices between the cells in contact, and the two contact problems between them.

A contact covers 2 to 10 % of the grid. A dense product over its own cells takes less time than a
Fourier transform of the whole grid, and the results are equal. Single precision halves the memory
that each product reads, which limits its speed; its rounding (1e-7 of a displacement) is far below
the tolerance of the iterations. Products are written as loops: BLAS would start its threads, which
takes longer than the product and makes the last digits depend on the number of cores.

Pressure: unilateral contact by constrained conjugate gradients (Polonsky & Keer, Wear 231 (1999)
206-219, doi:10.1016/S0043-1648(99)00113-1), with the indentation prescribed instead of the force.

Stick and slip: Coulomb friction by projected Gauss-Seidel sweeps. Over one step the friction
problem with known pressure is convex: the shear tractions minimise the elastic energy less their
work on the stick displacements, each within its own disc of radius friction times pressure (J. J.
Kalker, "Three-Dimensional Elastic Bodies in Rolling Contact", 1990, section 4.3). A cell inside its
disc sticks; a cell on the rim slips along its own traction.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.types import FloatArray

Single = NDArray[np.float32]
Cells = NDArray[np.int64]

# Rows that are added beyond need when the matrices grow, so that they grow seldom.
SPARE_CAPACITY = 64

# Fraction of the way to its own solution that each cell moves in a friction sweep. Neighbours
# respond alike, so that a full step overshoots: 0.75 needs a tenth to a fifth fewer sweeps than 1.
RELAXATION = np.float32(0.75)
SMALLEST_SQUARE = np.float32(1e-30)  # Lower limit of the squared error.


class Influence:
    """Influence matrices of a changing set of cells, from the tables of one or more layers.

    Attributes:
        cells: ``(c,)`` flat index of the cell in each slot.
        matrices: ``(tables, capacity, capacity)`` response at each slot to unit traction at each
            other. Only the leading c by c parts hold values.
    """

    def __init__(self, tables: FloatArray) -> None:
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
        offset = cell_index[slots, None] - cell_index
        self.matrices[:, slots, : len(cell_index)] = self._unrolled.take(center + offset, axis=1)
        columns_of = self._unrolled.take(center - offset, axis=1).transpose(0, 2, 1)
        self.matrices[:, : len(cell_index), slots] = columns_of


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, forceinline=True)
def product_kernel(matrix: Single, vector: Single) -> Single:
    """Return the product of the leading square of a matrix with a shorter vector ``(c,)``."""
    count = len(vector)
    out = np.empty(count, np.float32)
    for i in range(count):
        total = np.float32(0.0)
        for j in range(count):
            total += matrix[i, j] * vector[j]
        out[i] = total
    return out


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def lateral_displacement_kernel(xx: Single, xy: Single, yy: Single, shear: Single) -> Single:
    """Return the lateral displacement ``(2, c)`` under a shear; see :func:`shear_kernel`."""
    count = shear.shape[1]
    out = np.empty((2, count), np.float32)
    for i in range(count):
        along_x = along_y = np.float32(0.0)
        for j in range(count):
            along_x += xx[i, j] * shear[0, j] + xy[i, j] * shear[1, j]
            along_y += xy[i, j] * shear[0, j] + yy[i, j] * shear[1, j]
        out[0, i], out[1, i] = along_x, along_y
    return out


@njit(cache=True, nogil=True)
def residual_kernel(error: Single, pressure: Single) -> tuple[np.float32, np.float32]:
    """Return the largest violation of the contact conditions, mm, and the squared error inside."""
    worst = square = np.float32(0.0)
    for i in range(len(error)):
        if pressure[i] > 0.0:
            worst = max(worst, abs(error[i]))
            square += error[i] * error[i]
        else:
            worst = max(worst, -error[i])
    return worst, square


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, forceinline=True)
def dot_kernel(one: Single, other: Single) -> np.float32:
    """Return the inner product of two ``(c,)`` vectors."""
    total = np.float32(0.0)
    for i in range(len(one)):
        total += one[i] * other[i]
    return total


@njit(cache=True, nogil=True)
def update_pressure_kernel(
    compliance: Single, error: Single, direction: Single, step: np.float32, pressure: Single
) -> tuple[bool, bool]:
    """Take one step along a direction, keep pressures positive, and load empty cells that overlap.

    Return whether a cell was added, and whether a pressure was clipped at zero; see
    :func:`pressure_kernel`. ``direction`` is zero for empty cells.
    """
    zero = np.float32(0.0)
    added = clipped = False
    for i in range(len(pressure)):
        wanted = pressure[i] - step * direction[i]
        if wanted <= zero and error[i] < zero:
            wanted = -error[i] / compliance[i, i]
            added = True
        clipped = clipped or wanted < zero
        pressure[i] = max(wanted, zero)
    return added, clipped


@njit(cache=True, nogil=True)
def pressure_kernel(
    compliance: Single, indentation: Single, pressure: Single, tolerance: float, most: int
) -> int:
    """Find p >= 0 with compliance @ p >= indentation, equal where p > 0.

    Args:
        compliance: ``(capacity, capacity)`` matrix whose leading c by c part is symmetric and
            positive definite, mm per N/mm².
        indentation: ``(c,)`` depth of the body below each cell's unloaded surface, mm.
        pressure: ``(c,)`` first guess, overwritten by the solution, N/mm².
        tolerance: Largest error of the indentation, mm.
        most: Largest number of iterations; the number used is returned.
    """
    zero = np.float32(0.0)
    for i in range(len(pressure)):  # a slice assignment would compile for seconds
        pressure[i] = max(pressure[i], zero)
    direction, error = np.zeros(len(pressure), np.float32), pressure
    previous, conjugate, changed = np.float32(1.0), zero, True
    for iteration in range(most):
        if changed:
            error = product_kernel(compliance, pressure)
            for i in range(len(pressure)):
                error[i] -= indentation[i]
        worst, square = residual_kernel(error, pressure)
        if worst <= tolerance:
            return iteration
        conjugate *= square / previous
        previous = max(square, SMALLEST_SQUARE)
        for i in range(len(pressure)):
            inside = pressure[i] > zero
            direction[i] = error[i] + conjugate * direction[i] if inside else zero
        response = product_kernel(compliance, direction)
        curvature = dot_kernel(response, direction)
        step = dot_kernel(error, direction) / curvature if curvature > zero else zero
        added, clipped = update_pressure_kernel(compliance, error, direction, step, pressure)
        # New cells end the conjugacy; released cells do not (Polonsky & Keer).
        conjugate = zero if added else np.float32(1.0)
        changed = added or clipped
        if not changed:
            for i in range(len(pressure)):
                error[i] -= step * response[i]
    return most


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def shear_kernel(
    xx: Single,
    xy: Single,
    yy: Single,
    target: Single,
    bound: Single,
    shear: Single,
    tolerance: float,
    max_sweeps: int,
) -> int:
    """Find the shear tractions that move each cell to its target, as far as friction allows.

    Args:
        xx: ``(capacity, capacity)`` displacement along x per shear along x, mm per N/mm².
        xy: ``(capacity, capacity)`` along x per shear along y (and along y per shear along x).
        yy: ``(capacity, capacity)`` along y per shear along y.
        target: ``(2, c)`` displacement of each cell if it sticks, mm.
        bound: ``(c,)`` largest shear, N/mm²; zero where nothing presses.
        shear: ``(2, c)`` first guess, overwritten by the solution, N/mm².
        tolerance: Largest change of a cell's displacement by its own shear in a sweep, mm.
        max_sweeps: Largest number of sweeps; the number used is returned.
    """
    count = len(bound)
    for sweep in range(max_sweeps):
        worst = np.float32(0.0)
        for i in range(count):
            if bound[i] <= 0.0:
                shear[0, i] = shear[1, i] = np.float32(0.0)
                continue
            error_x, error_y = target[0, i], target[1, i]
            for j in range(count):
                error_x -= xx[i, j] * shear[0, j] + xy[i, j] * shear[1, j]
                error_y -= xy[i, j] * shear[0, j] + yy[i, j] * shear[1, j]
            wanted_x = shear[0, i] + RELAXATION * error_x / xx[i, i]
            wanted_y = shear[1, i] + RELAXATION * error_y / yy[i, i]
            length = np.hypot(wanted_x, wanted_y)
            if length > bound[i]:
                wanted_x *= bound[i] / length
                wanted_y *= bound[i] / length
            change = max(abs(wanted_x - shear[0, i]), abs(wanted_y - shear[1, i]))
            worst = max(worst, change * xx[i, i])
            shear[0, i], shear[1, i] = wanted_x, wanted_y
        if worst <= RELAXATION * tolerance:
            return sweep + 1
    return max_sweeps
