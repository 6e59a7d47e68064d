"""Where a body presses, and how hard: unilateral contact by constrained conjugate gradients.

Source: Polonsky & Keer, Wear 231 (1999) 206-219, doi:10.1016/S0043-1648(99)00113-1, with the
indentation prescribed instead of the force, and with the product of the compliance and the
pressure taken over the cells in question only.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.influence import product_kernel

SMALLEST_SQUARE = np.float32(1e-30)
"""Keeps the first quotient of squared errors finite."""


@njit(cache=True)
def pressure_kernel(
    compliance: NDArray[np.float32],
    indentation: NDArray[np.float32],
    pressure: NDArray[np.float32],
    tolerance: float,
    most_iterations: int,
) -> int:
    """Find p >= 0 with compliance @ p >= indentation, equal where p > 0.

    Args:
        compliance: ``(room, room)`` matrix whose leading c by c part is symmetric and positive
            definite, mm per N/mm².
        indentation: ``(c,)`` how far the body reaches into each cell's unloaded surface, mm.
        pressure: ``(c,)`` first guess, overwritten by the solution, N/mm².
        tolerance: Largest error of the indentation, mm.
        most_iterations: Where to stop at the latest.

    Returns:
        Number of iterations done.
    """
    count = len(pressure)
    direction = np.zeros(count, np.float32)
    previous = np.float32(1.0)
    conjugate = np.float32(0.0)
    zero = np.float32(0.0)
    for i in range(count):
        pressure[i] = max(pressure[i], zero)
    error = product_kernel(compliance, pressure) - indentation
    for iteration in range(most_iterations):
        worst = zero
        square = zero
        for i in range(count):
            if pressure[i] > 0.0:
                worst = max(worst, abs(error[i]))
                square += error[i] * error[i]
            else:
                worst = max(worst, -error[i])
        if worst <= tolerance:
            return iteration
        conjugate *= square / previous
        previous = max(square, SMALLEST_SQUARE)
        for i in range(count):
            inside = pressure[i] > 0.0
            direction[i] = error[i] + conjugate * direction[i] if inside else zero
        response = product_kernel(compliance, direction)
        along = zero
        curvature = zero
        for i in range(count):
            along += error[i] * direction[i]
            curvature += response[i] * direction[i]
        step = along / curvature if curvature > 0.0 else zero
        conjugate = np.float32(1.0)
        bent = False
        for i in range(count):
            wanted = pressure[i] - step * direction[i]
            if wanted <= 0.0 and error[i] < 0.0:
                wanted = -error[i] / compliance[i, i]
                conjugate = zero
            bent = bent or wanted < 0.0 or conjugate == 0.0
            pressure[i] = max(wanted, zero)
        error = (
            product_kernel(compliance, pressure) - indentation if bent else error - step * response
        )
    return most_iterations
