"""Kernels of :mod:`.evetac`: attraction by events, and the regulariser."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def attraction_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    center_px: NDArray[np.float64],
    inner_px: float,
    outer_px: float,
    turn_px: float,
    pull: NDArray[np.float64],
    support: NDArray[np.int64],
) -> None:
    """Sum g = 2 (d - R d / rho) over the events in each dot's ring; count the non-zero components.

    Args:
        x: ``(n,)`` columns, px.
        y: ``(n,)`` rows, px.
        center_px: ``(m, 2)`` dots, px.
        inner_px: Inner radius of the ring, px.
        outer_px: Outer radius of the ring, px.
        turn_px: R, the radius at which attraction would become repulsion, px; larger than
            ``outer_px``.
        pull: ``(m, 2)`` sums g, overwritten.
        support: ``(m,)`` numbers of non-zero components of g, overwritten.
    """
    pull[:] = 0.0
    support[:] = 0
    for i in range(len(x)):
        for m in range(len(center_px)):
            # Towards zero, as a conversion to integers does in the original's table.
            dx = np.trunc(x[i] - center_px[m, 0])
            dy = np.trunc(y[i] - center_px[m, 1])
            if abs(dx) > outer_px or abs(dy) > outer_px:
                continue
            rho = max(np.sqrt(dx * dx + dy * dy), 1.0)
            if inner_px < rho <= outer_px:
                weight = 2.0 * (1.0 - turn_px / rho)
                pull[m, 0] += weight * dx
                pull[m, 1] += weight * dy
                support[m] += (dx != 0.0) + (dy != 0.0)


@njit(cache=True)
def regularizer_kernel(
    center_px: NDArray[np.float64],
    neighbour: NDArray[np.int64],
    rest_px: NDArray[np.float64],
    regularizer: NDArray[np.float64],
) -> None:
    """Write h_i = 4 sum_j (c_j - c_i)(|c_j - c_i|^2 - D_ij^2), times 8 / (number of neighbours).

    Args:
        center_px: ``(m, 2)`` dots, px.
        neighbour: ``(m, k)`` indices of the neighbours, -1 beyond the last.
        rest_px: ``(m, k)`` calibrated distances D_ij, px.
        regularizer: ``(m, 2)`` k_i h_i, overwritten.
    """
    for i in range(len(center_px)):
        sum_x, sum_y, count = 0.0, 0.0, 0
        for k in range(neighbour.shape[1]):
            j = neighbour[i, k]
            if j >= 0:
                dx = center_px[j, 0] - center_px[i, 0]
                dy = center_px[j, 1] - center_px[i, 1]
                excess = dx * dx + dy * dy - rest_px[i, k] ** 2
                sum_x += 4.0 * dx * excess
                sum_y += 4.0 * dy * excess
                count += 1
        border = 8.0 / count if count else 0.0
        regularizer[i, 0] = border * sum_x
        regularizer[i, 1] = border * sum_y
