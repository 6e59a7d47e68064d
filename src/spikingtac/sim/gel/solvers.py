"""The two contact problems between the cells: pressure, and stick or slip.

Contact pressure: unilateral contact by constrained conjugate gradients.

Source: Polonsky & Keer, Wear 231 (1999) 206-219, doi:10.1016/S0043-1648(99)00113-1, with the
indentation prescribed instead of the force, and with the product of compliance and pressure over
the cells in question only.

Stick and slip: Coulomb friction by projected Gauss-Seidel sweeps.

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

from spikingtac.sim.gel.influence import SingleMatrix, SingleVector, product_kernel

# Lower limit of the squared error, which keeps the first quotient finite.
SMALLEST_SQUARE = np.float32(1e-30)


@njit(cache=True, nogil=True)
def residual_kernel(error: SingleVector, pressure: SingleVector) -> tuple[np.float32, np.float32]:
    """Return the largest violation of the contact conditions, and the squared error inside.

    Args:
        error: ``(c,)`` displacement less indentation, mm.
        pressure: ``(c,)``, N/mm².
    """
    worst = np.float32(0.0)
    square = np.float32(0.0)
    for i in range(len(error)):
        if pressure[i] > 0.0:
            worst = max(worst, abs(error[i]))
            square += error[i] * error[i]
        else:
            worst = max(worst, -error[i])
    return worst, square


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, forceinline=True)
def dot_kernel(one: SingleVector, other: SingleVector) -> np.float32:
    """Return the inner product of two ``(c,)`` vectors."""
    total = np.float32(0.0)
    for i in range(len(one)):
        total += one[i] * other[i]
    return total


@njit(cache=True, nogil=True)
def update_pressure_kernel(
    compliance: SingleMatrix,
    error: SingleVector,
    direction: SingleVector,
    step: np.float32,
    pressure: SingleVector,
) -> tuple[bool, bool]:
    """Take one step along a direction, keep pressures positive, and load empty cells that overlap.

    Args:
        compliance: ``(capacity, capacity)``, mm per N/mm².
        error: ``(c,)`` displacement less indentation, mm.
        direction: ``(c,)`` search direction, zero for empty cells.
        step: Length of the step along it.
        pressure: ``(c,)``, N/mm², changed in place.

    Returns:
        Whether a cell was added, and whether a pressure was clipped at zero.
    """
    zero = np.float32(0.0)
    added = False
    clipped = False
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
    compliance: SingleMatrix,
    indentation: SingleVector,
    pressure: SingleVector,
    tolerance: float,
    max_iterations: int,
) -> int:
    """Find p >= 0 with compliance @ p >= indentation, equal where p > 0.

    Args:
        compliance: ``(capacity, capacity)`` matrix whose leading c by c part is symmetric and
            positive definite, mm per N/mm².
        indentation: ``(c,)`` depth of the body below each cell's unloaded surface, mm.
        pressure: ``(c,)`` first guess, overwritten by the solution, N/mm².
        tolerance: Largest error of the indentation, mm.
        max_iterations: Largest number of iterations.

    Returns:
        Number of iterations.
    """
    zero = np.float32(0.0)
    for i in range(len(pressure)):  # a slice assignment would compile for seconds
        pressure[i] = max(pressure[i], zero)
    direction = np.zeros(len(pressure), np.float32)
    error = product_kernel(compliance, pressure)
    for i in range(len(pressure)):
        error[i] -= indentation[i]
    previous = np.float32(1.0)
    conjugate = zero
    for iteration in range(max_iterations):
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
        if added or clipped:
            error = product_kernel(compliance, pressure)
            for i in range(len(pressure)):
                error[i] -= indentation[i]
        else:
            for i in range(len(pressure)):
                error[i] -= step * response[i]
    return max_iterations


# Fraction of the way to its own solution that each cell moves in a sweep.
#
# Neighbours respond alike, so that a full step overshoots: 0.75 needs a tenth to a fifth fewer
# sweeps than 1; 1.5 needs twice as many.
RELAXATION = np.float32(0.75)


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
