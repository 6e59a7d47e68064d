"""Kernels of :mod:`spikingtac.baselines.ekalibr`: active events, normal flow, moving circles."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

NEVER = -(2**62)
"""Time of a pixel that never fired."""

PLANE_POINTS = 4
"""Fewest active pixels of nine that a plane is fitted to: one more than its parameters."""


@njit(cache=True)
def note_active_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    side: NDArray[np.int64],
    t: NDArray[np.int64],
    last_us: NDArray[np.int64],
) -> None:
    """Note the time of each pixel's last event in ``last_us (2, height, width)`` by polarity."""
    for i in range(len(x)):
        last_us[side[i], y[i], x[i]] = t[i]


@njit(cache=True)
def normal_flow_kernel(
    last_us: NDArray[np.int64],
    since_us: int,
    rounds: int,
    tolerance_us: float,
    inlier_share: float,
    flow: NDArray[np.float64],
) -> None:
    """Fit a plane t = a x + b y + c to each active pixel's 3x3 and write its normal flow, px/us.

    The flow is the gradient over its own square; 0 where no plane fits. Outliers are left out after
    each round.

    Args:
        last_us: ``(height, width)`` last event times of one polarity, us.
        since_us: Older pixels are not active.
        rounds: How often the plane is fitted.
        tolerance_us: Largest residual of an inlier, us.
        inlier_share: Smallest share of inliers among the active pixels.
        flow: ``(2, height, width)`` where to write x and y.
    """
    height, width = last_us.shape
    flow[:] = 0.0
    dx, dy, dt = np.empty(9), np.empty(9), np.empty(9)
    use = np.empty(9, np.bool_)
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            own = last_us[row, column]
            if own < since_us:
                continue
            count = 0
            for j in range(-1, 2):
                for i in range(-1, 2):
                    then = last_us[row + j, column + i]
                    if then >= since_us:
                        dx[count], dy[count], dt[count] = i, j, then - own
                        use[count] = True
                        count += 1
            a, b, kept = 0.0, 0.0, count
            for _ in range(rounds):
                if kept < PLANE_POINTS:
                    break
                a, b, c = _plane_kernel(dx, dy, dt, use, count)
                kept = 0
                for k in range(count):
                    use[k] = abs(dt[k] - a * dx[k] - b * dy[k] - c) <= tolerance_us
                    kept += use[k]
            square = a * a + b * b
            if kept >= PLANE_POINTS and kept >= inlier_share * count and square > 0.0:
                flow[0, row, column] = a / square
                flow[1, row, column] = b / square


@njit(cache=True)
def _plane_kernel(dx, dy, dt, use, count):  # type: ignore[no-untyped-def]
    n, sx, sy, st, sxx, sxy, syy, sxt, syt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        if use[k]:
            n += 1.0
            sx += dx[k]
            sy += dy[k]
            st += dt[k]
            sxx += dx[k] * dx[k]
            sxy += dx[k] * dy[k]
            syy += dy[k] * dy[k]
            sxt += dx[k] * dt[k]
            syt += dy[k] * dt[k]
    if n == 0.0:
        return 0.0, 0.0, 0.0
    mx, my, mt = sx / n, sy / n, st / n
    vxx, vxy, vyy = sxx - n * mx * mx, sxy - n * mx * my, syy - n * my * my
    vxt, vyt = sxt - n * mx * mt, syt - n * my * mt
    determinant = vxx * vyy - vxy * vxy
    if determinant < 1e-9:  # the points lie on a line
        return 0.0, 0.0, mt
    a = (vxt * vyy - vyt * vxy) / determinant
    b = (vyt * vxx - vxt * vxy) / determinant
    return a, b, mt - a * mx - b * my


@njit(cache=True)
def moving_circle_kernel(
    points: NDArray[np.float64], start: NDArray[np.float64], iterations: int
) -> tuple[NDArray[np.float64], float]:
    """Fit |e - c - v s| = r + q s to events by Gauss-Newton with a little damping.

    Args:
        points: ``(n, 3)`` events: x px, y px, and s, the time from the estimate back, scaled to
            -1 to 0 over the window.
        start: ``(6,)`` centre x, y, velocity x, y (px per window), radius, its growth.
        iterations: How many.

    Returns:
        The six parameters, and the mean absolute residual, px.
    """
    fit = start.copy()
    residual = np.inf
    damping = np.array([1e-6, 1e-6, 1e-2, 1e-2, 1e-2, 1e-1])
    row = np.empty(6)
    for step in range(iterations + 1):
        normal = np.zeros((6, 6))
        right = np.zeros(6)
        total = 0.0
        for i in range(len(points)):
            s = points[i, 2]
            ex = points[i, 0] - fit[0] - fit[2] * s
            ey = points[i, 1] - fit[1] - fit[3] * s
            distance = max(np.sqrt(ex * ex + ey * ey), 1e-9)
            error = distance - fit[4] - fit[5] * s
            total += abs(error)
            row[0], row[1] = ex / distance, ey / distance
            row[2], row[3] = row[0] * s, row[1] * s
            row[4], row[5] = 1.0, s
            for a in range(6):
                right[a] += row[a] * error
                for b in range(6):
                    normal[a, b] += row[a] * row[b]
        residual = total / max(len(points), 1)
        if step == iterations:
            break
        for a in range(6):
            normal[a, a] += damping[a] * len(points) + 1e-9
        fit += np.linalg.solve(normal, right)
    return fit, residual
