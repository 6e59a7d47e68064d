"""Which markers moved between two images, which of them share pixels, and in how many steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

_MARGIN_PX = 0.1
"""Slack around an edge, so that a pixel sees full and empty coverage before the edge has left."""

WORK_DTYPE = np.dtype(
    [
        ("leader", "i8"),  # lowest index of the markers that share pixels; -1: stays as it is
        ("following", "i8"),  # the next marker of the same group, -1 for the last
        ("steps", "i8"),  # of the group, at its leader
        ("x_first", "i8"),  # box that the marker can touch, not clipped, px
        ("y_first", "i8"),
        ("x_last", "i8"),
        ("y_last", "i8"),
        ("margin_px", "f8"),  # how far beyond an edge's reach pixels are visited
    ],
    align=True,
)
"""What is to be done for a marker between two images."""


@njit(cache=True, nogil=True, error_model="numpy")
def way_kernel(before: Any, after: Any) -> float:
    """Return how far a marker's edge moves at most, px (to first order in the strain)."""
    shift = math.hypot(after["x"] - before["x"], after["y"] - before["y"])
    strain = max(abs(after["xx"] - before["xx"]), abs(after["xy"] - before["xy"]))
    strain = max(strain, abs(after["yx"] - before["yx"]), abs(after["yy"] - before["yy"]))
    return shift + 2 * strain * after["radius"] + abs(after["radius"] - before["radius"])


@njit(cache=True, nogil=True, error_model="numpy")
def half_width_kernel(disc: Any) -> tuple[float, float]:
    """Return the half-widths of a marker's ellipse along x and y, px."""
    size = disc["radius"] / disc["scale"] ** 2
    half_x = size * math.hypot(disc["yy"], disc["xy"])
    half_y = size * math.hypot(disc["xx"], disc["yx"])
    return half_x, half_y


@njit(cache=True, nogil=True, error_model="numpy")
def box_kernel(before: Any, after: Any, slack_px: float, box: Any) -> None:
    """Write the box that a marker sweeps, ``slack_px`` wider on every side, not clipped."""
    x0, y0 = half_width_kernel(before)
    x1, y1 = half_width_kernel(after)
    box["x_first"] = math.floor(min(before["x"] - x0, after["x"] - x1) - slack_px)
    box["y_first"] = math.floor(min(before["y"] - y0, after["y"] - y1) - slack_px)
    box["x_last"] = math.ceil(max(before["x"] + x0, after["x"] + x1) + slack_px)
    box["y_last"] = math.ceil(max(before["y"] + y0, after["y"] + y1) + slack_px)
    if before["radius"] <= 0.0 and after["radius"] <= 0.0:
        box["x_last"], box["y_last"] = box["x_first"] - 1, box["y_first"] - 1


@njit(cache=True, nogil=True, error_model="numpy")
def _apart_kernel(one: Any, two: Any) -> bool:
    apart_x = one["x_first"] > two["x_last"] or two["x_first"] > one["x_last"]
    apart_y = one["y_first"] > two["y_last"] or two["y_first"] > one["y_last"]
    gone = one["x_last"] < one["x_first"] or two["x_last"] < two["x_first"]
    return apart_x or apart_y or gone


@njit(cache=True, nogil=True, error_model="numpy")
def _join_kernel(work: NDArray[Any]) -> None:
    """Give markers whose boxes meet one leader, if one of them moves."""
    changed = True
    while changed:
        changed = False
        for a in range(work.shape[0]):
            for b in range(a + 1, work.shape[0]):
                one, two = work[a]["leader"], work[b]["leader"]
                if one == two or _apart_kernel(work[a], work[b]):
                    continue
                low = a if one < 0 else one
                if two >= 0:
                    low = min(low, two)
                work[a]["leader"] = work[b]["leader"] = low
                changed = True


@njit(cache=True, nogil=True, error_model="numpy")
def _chain_kernel(work: NDArray[Any]) -> None:
    """Chain the members of each group and give its leader the most steps."""
    for k in range(work.shape[0]):
        work[k]["following"] = -1
        leader = work[k]["leader"]
        if leader < 0 or leader == k:
            continue
        last = leader
        while work[last]["following"] >= 0:
            last = work[last]["following"]
        work[last]["following"] = k
        work[leader]["steps"] = max(work[leader]["steps"], work[k]["steps"])


@njit(cache=True, nogil=True, error_model="numpy")
def plan_kernel(
    before: NDArray[Any],
    after: NDArray[Any],
    work: NDArray[Any],
    reach_px: float,
    span_us: float,
    limits: tuple[float, float, float, float],
) -> None:
    """Plan the work between two images.

    Args:
        before: ``(m,)`` markers as they were last rendered.
        after: ``(m,)`` markers at the end.
        work: ``(m,)`` of :data:`WORK_DTYPE`, overwritten.
        reach_px: Half-width of a marker's edge.
        span_us: Time between the images.
        limits: ``motion_px, min_us, max_us, still_px`` of the configured steps.
    """
    motion_px, min_us, max_us, still_px = limits
    for k in range(work.shape[0]):
        task = work[k]
        way_px = way_kernel(before[k], after[k])
        task["leader"] = k if way_px > still_px else -1
        steps = min(math.ceil(way_px / motion_px), math.floor(span_us / min_us))
        task["steps"] = max(1, steps, math.ceil(span_us / max_us))
        task["margin_px"] = way_px / task["steps"] + _MARGIN_PX
        box_kernel(before[k], after[k], reach_px + task["margin_px"], task)
    _join_kernel(work)
    _chain_kernel(work)


@njit(cache=True, nogil=True, error_model="numpy")
def swept_kernel(work: NDArray[Any], width: int, height: int) -> int:
    """Return how many pixels of a sensor the moving markers' boxes hold at most.

    A tip that is pushed much too far throws markers far beyond the sensor, or across all of it.
    """
    swept = 0
    for k in range(work.shape[0]):
        box = work[k]
        if box["leader"] >= 0:
            rows = max(0, min(box["y_last"], height - 1) - max(box["y_first"], 0) + 1)
            swept += rows * max(0, min(box["x_last"], width - 1) - max(box["x_first"], 0) + 1)
    return min(swept, width * height)
