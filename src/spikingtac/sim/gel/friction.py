"""Stick and slip: Coulomb friction by projected Gauss-Seidel sweeps.

Over one step the friction problem with known pressure is convex: the shear tractions minimise the
elastic energy less their work on the stick displacements, each within its own disc of radius
friction times pressure (Kalker's principle; J. J. Kalker, "Three-Dimensional Elastic Bodies in
Rolling Contact", 1990, section 4.3). A cell inside its disc sticks; a cell on the rim slips along
its own traction.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

RELAXATION = np.float32(0.75)
"""Fraction of the way to its own solution that each cell moves in a sweep.

Neighbours respond alike, so that a full step overshoots: 0.75 needs a tenth to a fifth fewer sweeps
than 1; 1.5 needs twice as many.
"""


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def shear_kernel(
    xx: NDArray[np.float32],
    xy: NDArray[np.float32],
    yy: NDArray[np.float32],
    target: NDArray[np.float32],
    bound: NDArray[np.float32],
    shear: NDArray[np.float32],
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
        max_sweeps: Largest number of sweeps.

    Returns:
        Number of sweeps.
    """
    count = len(bound)
    for sweep in range(max_sweeps):
        worst = np.float32(0.0)
        for i in range(count):
            if bound[i] <= 0.0:
                shear[0, i] = np.float32(0.0)
                shear[1, i] = np.float32(0.0)
                continue
            error_x = target[0, i]
            error_y = target[1, i]
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
            shear[0, i] = wanted_x
            shear[1, i] = wanted_y
        if worst <= RELAXATION * tolerance:
            return sweep + 1
    return max_sweeps
