"""Exchange between the grid and the cells in contact.

The kernels are plain loops over a few hundred cells. As array expressions they would take longer
than the solvers.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.arrays import FloatArray
from spikingtac.sim.gel.influence import Cells

Flags = NDArray[np.bool_]
Single = NDArray[np.float32]


@njit(cache=True, nogil=True)
def attached_displacement_kernel(
    sticking: Flags,
    anchor_mm: FloatArray,
    rotation: FloatArray,
    center: FloatArray,
    rest: FloatArray,
    relative: FloatArray,
) -> None:
    """Overwrite the displacement of sticking cells by that of their anchors on the body.

    Args:
        sticking: ``(n²,)`` True for cells that stick.
        anchor_mm: ``(n², 3)`` anchors in the body's own frame, mm.
        rotation: ``(3, 3)`` orientation of the body.
        center: ``(3,)`` centre of the body, mm.
        rest: ``(2, n²)`` cells at rest, mm.
        relative: ``(2, n²)`` displacement against the body's undeformed shape, mm; overwritten
            where a cell sticks.
    """
    for cell in range(len(sticking)):
        if sticking[cell]:
            for axis in range(2):
                place = center[axis]
                for own in range(3):
                    place += rotation[axis, own] * anchor_mm[cell, own]
                relative[axis, cell] = place - rest[axis, cell]


@njit(cache=True, nogil=True)
def gather_cells_kernel(
    cells: Cells,
    traction: FloatArray,
    change: FloatArray,
    prescribed: FloatArray,
    history: FloatArray,
    guess: Single,
    target: Single,
) -> None:
    """Read from the grid what the solvers need. The first guesses extrapolate the last step.

    Args:
        cells: ``(c,)`` flat index of each cell.
        traction: ``(3, n²)`` traction of the last step, N/mm².
        change: ``(3, n²)`` change of the traction in the last step, N/mm².
        prescribed: ``(3, n²)`` displacement if a cell sticks (x, y) or is pressed (z), mm.
        history: ``(3, n²)`` displacement that former tractions leave, mm.
        guess: ``(3, c)`` initial tractions, N/mm², overwritten.
        target: ``(3, c)`` displacement that the tractions must cause, mm, overwritten.
    """
    for i in range(len(cells)):
        cell = cells[i]
        for axis in range(3):
            guess[axis, i] = traction[axis, cell] + change[axis, cell]
            target[axis, i] = prescribed[axis, cell] - history[axis, cell]
        if traction[2, cell] == 0.0:
            guess[2, i] = 0.0


@njit(cache=True, nogil=True)
def scatter_cells_kernel(
    cells: Cells, shear: Single, pressure: Single, traction: FloatArray, change: FloatArray
) -> None:
    """Write the solution and its change to the grid, and zero elsewhere.

    Args:
        cells: ``(c,)`` flat index of each cell.
        shear: ``(2, c)``, N/mm².
        pressure: ``(c,)``, N/mm².
        traction: ``(3, n²)``, N/mm², overwritten.
        change: ``(3, n²)``, N/mm², overwritten.
    """
    change[:] = 0.0
    for i in range(len(cells)):
        cell = cells[i]
        change[0, cell] = shear[0, i] - traction[0, cell]
        change[1, cell] = shear[1, i] - traction[1, cell]
        change[2, cell] = pressure[i] - traction[2, cell]
    traction[:] = 0.0
    for i in range(len(cells)):
        cell = cells[i]
        traction[0, cell] = shear[0, i]
        traction[1, cell] = shear[1, i]
        traction[2, cell] = pressure[i]


@njit(cache=True, nogil=True)
def set_anchors_kernel(
    fresh: Cells,
    rest: FloatArray,
    relative: FloatArray,
    reach: FloatArray,
    pose: FloatArray,
    anchor_mm: FloatArray,
) -> None:
    """Store the place on the body of each cell that has begun to stick.

    Args:
        fresh: ``(f,)`` flat index of those cells.
        rest: ``(2, n²)`` cells at rest, mm.
        relative: ``(2, n²)`` displacement against the body's undeformed shape, mm.
        reach: ``(n²,)`` height of the body's surface there, mm.
        pose: ``(3, 4)`` rotation of the body, then its centre, mm.
        anchor_mm: ``(n², 3)`` anchors in the body's own frame, mm, overwritten for those cells.
    """
    for cell in fresh:
        x = rest[0, cell] + relative[0, cell] - pose[0, 3]
        y = rest[1, cell] + relative[1, cell] - pose[1, 3]
        z = reach[cell] - pose[2, 3]
        for own in range(3):
            anchor_mm[cell, own] = pose[0, own] * x + pose[1, own] * y + pose[2, own] * z
