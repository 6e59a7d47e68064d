"""Between the grid and the cells in contact: what a step takes from it and writes back.

Plain loops over a few hundred cells; as array expressions they would cost more than the solvers.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]
Flags = NDArray[np.bool_]
Cells = NDArray[np.int64]
Single = NDArray[np.float32]


@njit(cache=True, nogil=True)
def carry_kernel(
    held: Flags, body: Field, rotation: Field, center: Field, rest: Field, relative: Field
) -> None:
    """Overwrite the displacement of held cells by that of the places they are attached to.

    Args:
        held: ``(n²,)`` cells that are attached.
        body: ``(n², 3)`` where, in the body's own frame, mm.
        rotation: ``(3, 3)`` orientation of the body.
        center: ``(3,)`` its centre, mm.
        rest: ``(2, n²)`` cells at rest, mm.
        relative: ``(2, n²)`` displacement against the body's undeformed shape, mm.
    """
    for cell in range(len(held)):
        if held[cell]:
            for axis in range(2):
                place = center[axis]
                for own in range(3):
                    place += rotation[axis, own] * body[cell, own]
                relative[axis, cell] = place - rest[axis, cell]


@njit(cache=True, nogil=True)
def collect_kernel(
    cells: Cells,
    traction: Field,
    change: Field,
    asked: Field,
    history: Field,
    guess: Single,
    target: Single,
) -> None:
    """Take from the grid what the solvers need; guesses go on as in the last step.

    Args:
        cells: ``(c,)`` flat index of each cell.
        traction: ``(3, n²)`` of the last step, N/mm².
        change: ``(3, n²)`` of the traction in the last step, N/mm².
        asked: ``(3, n²)`` displacement if a cell sticks (x, y) or is pressed (z), mm.
        history: ``(3, n²)`` displacement left by former tractions, mm.
        guess: ``(3, c)`` tractions to begin with, to fill.
        target: ``(3, c)`` displacement that the tractions have to bring about, to fill.
    """
    for i in range(len(cells)):
        cell = cells[i]
        for axis in range(3):
            guess[axis, i] = traction[axis, cell] + change[axis, cell]
            target[axis, i] = asked[axis, cell] - history[axis, cell]
        if traction[2, cell] == 0.0:
            guess[2, i] = 0.0


@njit(cache=True, nogil=True)
def deposit_kernel(
    cells: Cells, shear: Single, pressure: Single, traction: Field, change: Field
) -> None:
    """Write the solution to the grid, zero elsewhere, and how much it changed.

    Args:
        cells: ``(c,)`` flat index of each cell.
        shear: ``(2, c)``, N/mm².
        pressure: ``(c,)``, N/mm².
        traction: ``(3, n²)``, overwritten.
        change: ``(3, n²)``, overwritten.
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
def attach_kernel(
    fresh: Cells, rest: Field, relative: Field, reach: Field, pose: Field, body: Field
) -> None:
    """Remember where on the body each freshly touching cell is.

    Args:
        fresh: ``(f,)`` flat index of those cells.
        rest: ``(2, n²)`` cells at rest, mm.
        relative: ``(2, n²)`` displacement against the body's undeformed shape, mm.
        reach: ``(n²,)`` height of the body's surface there, mm.
        pose: ``(3, 4)`` the body's rotation, then its centre, mm.
        body: ``(n², 3)`` places in the body's own frame, to write.
    """
    for cell in fresh:
        x = rest[0, cell] + relative[0, cell] - pose[0, 3]
        y = rest[1, cell] + relative[1, cell] - pose[1, 3]
        z = reach[cell] - pose[2, 3]
        for own in range(3):
            body[cell, own] = pose[0, own] * x + pose[1, own] * y + pose[2, own] * z
