"""Fit discs to the levels at which pixels fired last."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.disc_levels import (
    INSIDE_EDGES,
    LEVEL_VARIANCE,
    MARGIN_PX,
    OUTSIDE_EDGES,
    REACH_EDGES,
    TABLE_STEPS,
    bounds_kernel,
    crowded_kernel,
    nearer_kernel,
)

# Gauss-Newton steps at each sample: the markers move by less than a pixel between two.
ITERATIONS = 3

LARGEST_STEP_PX = 1.5  # Bound of one Gauss-Newton step.

RESIDUAL_LEVEL = 0.3  # Residuals beyond this level count less (Cauchy weights).

IN_BAND_WEIGHT = 0.6  # A level inside of its band counts less than one outside of it.

AGREEING_LEVEL = 0.35  # A pixel agrees with the disc within this level.

SMALL_STEP_PX = 0.01  # A fit ends after a smaller step.

# Pixels are gathered this far beyond a fit's annulus, so that a fit that moves less needs no
# others.
REACH_MARGIN_PX = 1.5

# What a fit knows of all discs: places, nearest others, shapes and ``fit_tables``.
Scene = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float32]]

# Rows of a fit's room: x and y of each gathered pixel, where its light probably is, the weight of
# that, the ends of its band, and 1 where it is nearest to the fitted disc, otherwise 0.
ROWS = 7


def fit_room(shape: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return room ``(ROWS, pixels)`` for the pixels of the largest disc's fit.

    Args:
        shape: ``(m, 5)`` shapes of all discs.
    """
    reach_px = (shape[:, 0] + OUTSIDE_EDGES * shape[:, 1]).max() + MARGIN_PX + REACH_MARGIN_PX
    return np.empty((ROWS, int(2.0 * reach_px + 3.0) ** 2))


@njit(cache=True, nogil=True, error_model="numpy")
def gather_kernel(
    state: tuple[NDArray[np.float32], NDArray[np.int8]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    place: NDArray[np.float64],
    reach_px: float,
    room: NDArray[np.float64],
) -> int:
    """Gather the pixels within reach of a place, and return how many they are.

    The light of a pixel lies most likely half a step beyond the level at which it fired last, in
    the direction of that event.
    """
    level, side = state
    height, width = level.shape
    top, bottom = bounds_kernel(place[1], reach_px, height)
    left, right = bounds_kernel(place[0], reach_px, width)
    count = 0
    for y in range(top, bottom):
        for x in range(left, right):
            if (x - place[0]) ** 2 + (y - place[1]) ** 2 > reach_px * reach_px:
                continue
            on, off = np.float64(steps[0][y, x]), np.float64(steps[1][y, x])
            if side[y, x] > 0:
                ahead, spread = 0.5 * on, on
            elif side[y, x] < 0:
                ahead, spread = -0.5 * off, off
            else:
                ahead, spread = 0.5 * (on - off), on + off
            room[0, count], room[1, count] = x, y
            room[2, count] = level[y, x] + ahead
            room[3, count] = 1.0 / (LEVEL_VARIANCE + spread * spread / 12.0)
            room[4, count], room[5, count] = level[y, x] - off, level[y, x] + on
            count += 1
    return count


@njit(cache=True, nogil=True)
def claim_kernel(
    room: NDArray[np.float64], count: int, m: int, place: NDArray[np.float64], scene: Scene
) -> None:
    """Note which of the gathered pixels are not nearer to another disc's rim."""
    radius, edge = scene[2][m, 0], scene[2][m, 1]
    room[6, :count] = 1.0
    if not crowded_kernel(m, place, radius + OUTSIDE_EDGES * edge + MARGIN_PX, scene):
        return
    for i in range(count):
        x, y = room[0, i], room[1, i]
        q = np.sqrt((x - place[0]) ** 2 + (y - place[1]) ** 2) - radius
        if nearer_kernel(x, y, q, m, scene):
            room[6, i] = 0.0


# Without branches and with sums in any order, several pixels are computed at once.
@njit(
    cache=True,
    nogil=True,
    error_model="numpy",
    fastmath={"reassoc", "contract", "nsz"},
    forceinline=True,
)
def sums_kernel(
    room: NDArray[np.float64],
    count: int,
    look: tuple[float, float],
    place: NDArray[np.float64],
    table: NDArray[np.float32],
) -> tuple[float, float, float, float, float, float, float]:
    """Return the normal equations of a centre: xx, xy, yy, x, y, edge in all, edge agreeing.

    Args:
        room: The gathered pixels.
        count: How many they are.
        look: Radius and edge width of the disc, px.
        place: Its place, px.
        table: ``(2, TABLE_STEPS)`` level and its fall per edge width.
    """
    radius, edge = look
    outer, inner = OUTSIDE_EDGES * edge + MARGIN_PX, -INSIDE_EDGES * edge - MARGIN_PX
    per_edge, per_residual = 1.0 / edge, 1.0 / RESIDUAL_LEVEL**2
    cells_per_edge, last = (TABLE_STEPS - 1) / (2.0 * REACH_EDGES), np.float64(TABLE_STEPS - 1)
    levels, falls = table[0], table[1]
    cx, cy = place[0], place[1]
    xx = xy = yy = along_x = along_y = edges = agreeing = 0.0
    for i in range(count):
        dx, dy = room[0, i] - cx, room[1, i] - cy
        rho = np.sqrt(dx * dx + dy * dy)
        q = rho - radius
        at = (q * per_edge + REACH_EDGES) * cells_per_edge
        cell = np.int32(min(max(at, 0.0), last - 1.0))
        share = at - cell
        expected = levels[cell] + share * (levels[cell + 1] - levels[cell])
        expected = 1.0 if at <= 0.0 else (0.0 if at >= last else expected)
        fall = falls[cell] + share * (falls[cell + 1] - falls[cell])
        on_rim = q <= outer and q >= inner and rho >= 0.5 and at > 0.0 and at < last
        slope = fall * per_edge * room[6, i] if on_rim else 0.0
        error = room[2, i] - expected
        weight = room[3, i] / (1.0 + error * error * per_residual)
        in_band = room[4, i] <= expected and expected <= room[5, i]
        weight = weight * IN_BAND_WEIGHT if in_band else weight
        along = slope / max(rho, 0.5)
        gx, gy = along * dx, along * dy
        xx += weight * gx * gx
        xy += weight * gx * gy
        yy += weight * gy * gy
        along_x += weight * gx * error
        along_y += weight * gy * error
        edges += slope
        agreeing += slope if abs(error) < AGREEING_LEVEL else 0.0
    return xx, xy, yy, along_x, along_y, edges, agreeing


@njit(cache=True, nogil=True)
def fit_kernel(
    state: tuple[NDArray[np.float32], NDArray[np.int8]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    m: int,
    place: NDArray[np.float64],
    scene: Scene,
    room: NDArray[np.float64],
) -> float:
    """Move ``place`` to where the disc fits best; return the share of its edge that agrees.

    ``state`` is the level at which each pixel last fired and the polarity of that event (0: none
    yet); ``scene`` is places ``(m, 2)``, nearest others ``(m, k)``, shapes ``(m, 5)`` and
    ``fit_tables``; ``room`` is that of :func:`fit_room`.
    """
    look = (scene[2][m, 0], scene[2][m, 1])
    table, edges, agreeing = scene[3][m], 0.0, 0.0
    reach_px = look[0] + OUTSIDE_EDGES * look[1] + MARGIN_PX + REACH_MARGIN_PX
    gathered, count = place.copy(), gather_kernel(state, steps, place, reach_px, room)
    for _ in range(ITERATIONS):
        if np.hypot(place[0] - gathered[0], place[1] - gathered[1]) > REACH_MARGIN_PX:
            gathered[0], gathered[1] = place[0], place[1]
            count = gather_kernel(state, steps, place, reach_px, room)
        claim_kernel(room, count, m, place, scene)
        xx, xy, yy, x, y, edges, agreeing = sums_kernel(room, count, look, place, table)
        det = xx * yy - xy * xy
        if det <= 1e-9:
            break
        sx = (yy * x - xy * y) / det
        sy = (xx * y - xy * x) / det
        length = np.sqrt(sx * sx + sy * sy)
        shrink = LARGEST_STEP_PX / length if length > LARGEST_STEP_PX else 1.0
        place[0] += shrink * sx
        place[1] += shrink * sy
        if length < SMALL_STEP_PX:
            break
    return agreeing / edges if edges > 0.0 else 0.0


@njit(cache=True, nogil=True)
def fit_some_kernel(
    state: tuple[NDArray[np.float32], NDArray[np.int8]],
    steps: tuple[NDArray[np.float32], NDArray[np.float32]],
    chosen: tuple[int, int],
    center: NDArray[np.float64],
    scene: Scene,
    out: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Fit the discs from one number to another; what one finds does not depend on the others.

    ``center`` ``(m, 2)`` is moved; ``out`` is the agreement ``(m,)`` to fill, and room.
    """
    agreement, room = out
    for m in range(chosen[0], chosen[1]):
        agreement[m] = fit_kernel(state, steps, m, center[m], scene, room)
