"""Plan of a sweep: which markers move, which of them share pixels, and how many steps they take."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

_MARGIN_PX = 0.1
"""Margin around an edge, so that pixels see zero and full coverage before the edge passes."""

SWEEP_PLAN_DTYPE = np.dtype(
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
"""How one marker is rendered between two images."""


@njit(cache=True, nogil=True, error_model="numpy")
def edge_travel_kernel(before: Any, after: Any) -> float:
    """Return the largest travel of a marker's edge, px (to first order in the strain)."""
    shift = math.hypot(after["x"] - before["x"], after["y"] - before["y"])
    strain = max(abs(after["xx"] - before["xx"]), abs(after["xy"] - before["xy"]))
    strain = max(strain, abs(after["yx"] - before["yx"]), abs(after["yy"] - before["yy"]))
    return shift + 2 * strain * after["radius"] + abs(after["radius"] - before["radius"])


@njit(cache=True, nogil=True, error_model="numpy")
def ellipse_half_widths_kernel(disc: Any) -> tuple[float, float]:
    """Return the half-widths of a marker's ellipse along x and y, px."""
    size = disc["radius"] / disc["scale"] ** 2
    half_x = size * math.hypot(disc["yy"], disc["xy"])
    half_y = size * math.hypot(disc["xx"], disc["yx"])
    return half_x, half_y


@njit(cache=True, nogil=True, error_model="numpy")
def bounding_box_kernel(before: Any, after: Any, slack_px: float, box: Any) -> None:
    """Write the box that a marker sweeps, not clipped to the sensor.

    Args:
        before: Record of :data:`~spikingtac.sim.camera.pixel_coverage.DISC_DTYPE` at the start.
        after: The same marker at the end.
        slack_px: Margin on every side, px.
        box: Record of :data:`SWEEP_PLAN_DTYPE`, whose box is overwritten.
    """
    x0, y0 = ellipse_half_widths_kernel(before)
    x1, y1 = ellipse_half_widths_kernel(after)
    box["x_first"] = math.floor(min(before["x"] - x0, after["x"] - x1) - slack_px)
    box["y_first"] = math.floor(min(before["y"] - y0, after["y"] - y1) - slack_px)
    box["x_last"] = math.ceil(max(before["x"] + x0, after["x"] + x1) + slack_px)
    box["y_last"] = math.ceil(max(before["y"] + y0, after["y"] + y1) + slack_px)
    if before["radius"] <= 0.0 and after["radius"] <= 0.0:
        box["x_last"], box["y_last"] = box["x_first"] - 1, box["y_first"] - 1


@njit(cache=True, nogil=True, error_model="numpy")
def _disjoint_kernel(one: Any, two: Any) -> bool:
    apart_x = one["x_first"] > two["x_last"] or two["x_first"] > one["x_last"]
    apart_y = one["y_first"] > two["y_last"] or two["y_first"] > one["y_last"]
    gone = one["x_last"] < one["x_first"] or two["x_last"] < two["x_first"]
    return apart_x or apart_y or gone


@njit(cache=True, nogil=True, error_model="numpy")
def _group_overlapping_kernel(plan: NDArray[Any]) -> None:
    """Give markers with overlapping boxes a common leader if one of them moves."""
    changed = True
    while changed:
        changed = False
        for a in range(plan.shape[0]):
            for b in range(a + 1, plan.shape[0]):
                one, two = plan[a]["leader"], plan[b]["leader"]
                if one == two or _disjoint_kernel(plan[a], plan[b]):
                    continue
                low = a if one < 0 else one
                if two >= 0:
                    low = min(low, two)
                plan[a]["leader"] = plan[b]["leader"] = low
                changed = True


@njit(cache=True, nogil=True, error_model="numpy")
def _link_groups_kernel(plan: NDArray[Any]) -> None:
    """Link the members of each group in a list and give its leader the largest number of steps."""
    for k in range(plan.shape[0]):
        plan[k]["following"] = -1
        leader = plan[k]["leader"]
        if leader < 0 or leader == k:
            continue
        last = leader
        while plan[last]["following"] >= 0:
            last = plan[last]["following"]
        plan[last]["following"] = k
        plan[leader]["steps"] = max(plan[leader]["steps"], plan[k]["steps"])


@njit(cache=True, nogil=True, error_model="numpy")
def plan_sweep_kernel(
    before: NDArray[Any],
    after: NDArray[Any],
    plan: NDArray[Any],
    edge_half_width_px: float,
    span_us: float,
    limits: tuple[float, float, float, float],
) -> None:
    """Plan how the markers are rendered between two images.

    Args:
        before: ``(m,)`` markers as they were last rendered.
        after: ``(m,)`` markers at the end.
        plan: ``(m,)`` records of :data:`SWEEP_PLAN_DTYPE`, overwritten.
        edge_half_width_px: Half-width of a marker's blurred edge, px.
        span_us: Time between the images, us.
        limits: ``motion_px, min_us, max_us, still_px`` of
            :class:`~spikingtac.sim.camera.config.StepConfig`.
    """
    motion_px, min_us, max_us, still_px = limits
    for k in range(plan.shape[0]):
        item = plan[k]
        travel_px = edge_travel_kernel(before[k], after[k])
        item["leader"] = k if travel_px > still_px else -1
        steps = min(math.ceil(travel_px / motion_px), math.floor(span_us / min_us))
        item["steps"] = max(1, steps, math.ceil(span_us / max_us))
        item["margin_px"] = travel_px / item["steps"] + _MARGIN_PX
        bounding_box_kernel(before[k], after[k], edge_half_width_px + item["margin_px"], item)
    _group_overlapping_kernel(plan)
    _link_groups_kernel(plan)


@njit(cache=True, nogil=True, error_model="numpy")
def swept_pixel_count_kernel(plan: NDArray[Any], width: int, height: int) -> int:
    """Return an upper bound of the number of pixels in the boxes of the moving markers.

    The boxes are clipped to the sensor: a tip that is pushed much too far moves markers far beyond
    the sensor, or across all of it.
    """
    swept = 0
    for k in range(plan.shape[0]):
        box = plan[k]
        if box["leader"] >= 0:
            rows = max(0, min(box["y_last"], height - 1) - max(box["y_first"], 0) + 1)
            swept += rows * max(0, min(box["x_last"], width - 1) - max(box["x_first"], 0) + 1)
    return min(swept, width * height)
