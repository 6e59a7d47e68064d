"""Kernels of :mod:`.ekalibr`: active events, normal flow, moving circles."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

NEVER = -(2**62)  # Time of a pixel without any event, us.

# Smallest number of active pixels, of nine, for a plane: one more than its parameters.
PLANE_POINTS = 4


@njit(cache=True)
def update_active_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.int64],
    t: NDArray[np.int64],
    last_us: NDArray[np.int64],
) -> None:
    """Store the time of each pixel's last event.

    Args:
        x: ``(n,)`` columns, px.
        y: ``(n,)`` rows, px.
        polarity: ``(n,)`` 1 for brighter, 0 for darker.
        t: ``(n,)`` times, us.
        last_us: ``(2, height, width)`` last times by polarity, us, updated.
    """
    for i in range(len(x)):
        last_us[polarity[i], y[i], x[i]] = t[i]


@njit(cache=True)
def normal_flow_kernel(
    last_us: NDArray[np.int64],
    since_us: int,
    rounds: int,
    tolerance_us: float,
    inlier_fraction: float,
    flow: NDArray[np.float64],
) -> None:
    """Fit a plane t = a x + b y + c to each active pixel's 3x3 and write its normal flow, px/us.

    The flow is the gradient divided by its square; it is 0 where no plane fits. Outliers are
    removed after each fit.

    Args:
        last_us: ``(height, width)`` last event times of one polarity, us.
        since_us: Pixels with an older last event are not active, us.
        rounds: Number of fits of the plane.
        tolerance_us: Largest residual of an inlier, us.
        inlier_fraction: Smallest fraction of inliers among the active pixels.
        flow: ``(2, height, width)`` flow along x and y, px/us, overwritten.
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
            if kept >= PLANE_POINTS and kept >= inlier_fraction * count and square > 0.0:
                flow[0, row, column] = a / square
                flow[1, row, column] = b / square


@njit(cache=True)
def _plane_kernel(
    dx: NDArray[np.float64],
    dy: NDArray[np.float64],
    dt: NDArray[np.float64],
    use: NDArray[np.bool_],
    count: int,
) -> tuple[float, float, float]:
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
    """Fit |e - c - v s| = r + q s to events by damped Gauss-Newton iterations.

    Args:
        points: ``(n, 3)`` events: x px, y px, and s, the time relative to the estimate, scaled to
            -1 to 0 over the window.
        start: ``(6,)`` first guess: centre x, y, velocity x, y (px per window), radius, growth of
            the radius.
        iterations: Number of iterations.

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
        solve_kernel(normal, right)
        for a in range(6):
            fit[a] += right[a]
    return fit, residual


@njit(cache=True)
def solve_kernel(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> None:
    """Solve for a positive definite matrix, in place, by elimination; ``right`` is the solution.

    (``np.linalg.solve`` gives the same, and takes seconds to compile.)
    """
    size = len(right)
    for a in range(size):
        for b in range(a + 1, size):
            factor = matrix[b, a] / matrix[a, a]
            right[b] -= factor * right[a]
            for c in range(a + 1, size):
                matrix[b, c] -= factor * matrix[a, c]
    for a in range(size - 1, -1, -1):
        for b in range(a + 1, size):
            right[a] -= matrix[a, b] * right[b]
        right[a] /= matrix[a, a]
