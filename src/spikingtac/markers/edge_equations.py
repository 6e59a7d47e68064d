"""The robust normal equations of a disc's edge, summed to the same bits on every processor.

A sum of floating-point numbers depends on its order, and a compiler that may choose the order takes
one that suits the width of the processor's registers. Tracks then differ from machine to machine,
by far more than the last bit where a fit takes one step more or less (measured: 5e-4 px). Sums of
whole numbers do not depend on their order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

LARGEST_SUM = 2.0**30
"""Largest magnitude of a sum of the normal equations, in steps."""

SAME_BITS = {"nnan", "ninf", "nsz"}
"""Freedom of the compiler that leaves results alone: no two operations become one, none is replaced
by an approximation, and no sum is regrouped. So a recording gives the same tracks everywhere."""


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def center_equations_kernel(
    edge: NDArray[np.float32],
    count: Any,
    moved: tuple[Any, Any],
    per_soft2: np.float32,
    unit: np.float32,
) -> tuple[Any, ...]:  # pragma: no cover - compiled
    """Sum the robust normal equations of a disc's centre; one straight loop, so that it vectorises.

    Sums are those of whole numbers, which come out the same in any order: the compiler may divide
    them between as many registers as a processor has. ``moved`` is how far the centre went since
    ``edge`` was read, px; ``per_soft2`` is 1 / soft^2. Returns the curvature (xx, xy, yy) and the
    gradients (x, y).
    """
    ux, uy, residual, slope = edge[1], edge[2], edge[3], edge[4]
    one = np.float32(1.0)
    xx = xy = yy = gx = gy = np.int32(0)
    for j in range(count):
        to_x, to_y, s = ux[j], uy[j], slope[j]
        e = residual[j] - s * (to_x * moved[0] + to_y * moved[1])
        ws = unit * s / (one + e * e * per_soft2)
        wse = ws * e
        wsx = ws * s * to_x
        wsy = ws * s * to_y
        xx = np.int32(xx + np.int32(wsx * to_x))
        xy = np.int32(xy + np.int32(wsx * to_y))
        yy = np.int32(yy + np.int32(wsy * to_y))
        gx = np.int32(gx + np.int32(wse * to_x))
        gy = np.int32(gy + np.int32(wse * to_y))
    part = 1.0 / float(unit)
    return (xx * part, xy * part, yy * part), (gx * part, gy * part)


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def outline_equations_kernel(
    edge: NDArray[np.float32],
    count: Any,
    moved: tuple[Any, Any],
    per_soft2: np.float32,
    unit: np.float32,
) -> tuple[Any, ...]:  # pragma: no cover - compiled
    """Sum the robust normal equations of a disc's outline as :func:`center_equations_kernel` does.

    Returns the gradients of r, b and c, the curvature of r, and the share of the edge that agrees.
    """
    ux, uy, residual, slope = edge[1], edge[2], edge[3], edge[4]
    one = np.float32(1.0)
    gr = gb = gc = rr = weight = total = np.int32(0)
    for j in range(count):
        to_x, to_y, s = ux[j], uy[j], slope[j]
        e = residual[j] - s * (to_x * moved[0] + to_y * moved[1])
        us = unit * s
        ws = us / (one + e * e * per_soft2)
        wse = ws * e
        gr = np.int32(gr + np.int32(wse))
        gb = np.int32(gb + np.int32(wse * (to_x * to_x - to_y * to_y)))
        gc = np.int32(gc + np.int32(wse * (np.float32(2.0) * to_x * to_y)))
        rr = np.int32(rr + np.int32(ws * s))
        weight = np.int32(weight + np.int32(ws))
        total = np.int32(total + np.int32(us))
    part = 1.0 / float(unit)
    return (gr * part, gb * part, gc * part), rr * part, weight / (total + 1.0)
