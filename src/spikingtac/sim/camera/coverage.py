"""Markers on the sensor: what they cover, and how their motion between two images is planned."""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.pixels import EDGE_ENTRIES
from spikingtac.sim.optics import MarkerImage

STEP_PX = 0.1  # Longest travel of a marker's edge in one step, px (reference twin.md).
SHORTEST_STEP_US = 20.0  # Shortest step, us. Faster motions travel further in one step.

# Margin around an edge, px, so that pixels see zero and full coverage before the edge passes.
_MARGIN_PX = 0.1

# One marker on the sensor. Centre, px. Shape, see MarkerImage: undeformed offset = (xx dx + xy dy,
# yx dx + yy dy). Radius, px, 0 where no marker is. Scale: undeformed px in one px of the sensor.
# Chord: what is left of a broken disc, see MarkerImage.
_DISC = ("x", "y", "xx", "xy", "yx", "yy", "radius", "scale", "chord_x", "chord_y", "chord_px")
DISC_DTYPE = np.dtype([(name, "f8") for name in _DISC])

# How one marker is rendered between two images. Leader: lowest index of the markers that share
# pixels, -1 where it stays as it is. Following: next marker of the same group, -1 for the last.
# Steps: of the group, at its leader. First and last: box that the marker can touch, not clipped,
# px. Margin: how far beyond an edge's reach pixels are visited, px.
_PLAN = ("leader", "following", "steps", "x_first", "y_first", "x_last", "y_last")
SWEEP_PLAN_DTYPE = np.dtype([*((name, "i8") for name in _PLAN), ("margin_px", "f8")])


def discs_of(image: MarkerImage) -> NDArray[Any]:
    """Return the markers of an image as ``(m,)`` records of :data:`DISC_DTYPE`."""
    discs = np.empty(len(image.center_px), DISC_DTYPE)
    chord = (0.0, 0.0, np.inf) if image.chord is None else np.asarray(image.chord).T
    (xx, xy), (yx, yy) = np.asarray(image.shape, np.float64).transpose(1, 2, 0)
    scale = np.sqrt(np.abs(xx * yy - xy * yx))
    columns = *np.asarray(image.center_px).T, xx, xy, yx, yy, image.radius_px, scale, *chord
    for name, column in zip(_DISC, columns, strict=True):
        discs[name] = column
    return discs


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def edge_coverage_kernel(chip: Any, inside_px: float) -> float:
    """Return the coverage (0 to 1) at a signed distance inside an edge, px."""
    if inside_px <= -chip["edge_half_width_px"]:
        return 0.0
    if inside_px >= chip["edge_half_width_px"]:
        return 1.0
    place = (inside_px + chip["edge_half_width_px"]) * chip["edge_per_px"]
    low = min(int(place), EDGE_ENTRIES - 2)
    first = float(chip["edge_coverage"][low])
    return first + (place - low) * (chip["edge_coverage"][low + 1] - first)


@njit(cache=True, nogil=True, error_model="numpy")
def disc_coverage_kernel(disc: Any, chip: Any, x: float, y: float) -> float:
    """Return the fraction of a pixel that a marker covers, 0 to 1.

    The blur acts on the sensor, so the disc's magnification is undone. The effect of its
    ellipticity on the blur is of second order and is neglected.
    """
    dx, dy = x - disc["x"], y - disc["y"]
    u = disc["xx"] * dx + disc["xy"] * dy
    v = disc["yx"] * dx + disc["yy"] * dy
    inside_px = (disc["radius"] - math.sqrt(u * u + v * v)) / disc["scale"]
    covered = edge_coverage_kernel(chip, inside_px)
    if disc["chord_px"] < disc["radius"]:
        left = disc["chord_px"] - disc["chord_x"] * u - disc["chord_y"] * v
        covered *= edge_coverage_kernel(chip, left / disc["scale"])
    return covered if disc["radius"] > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _half_size_kernel(disc: Any) -> tuple[float, float]:
    """Return half the width and half the height of a marker, px."""
    size = disc["radius"] / disc["scale"] ** 2
    return size * math.hypot(disc["yy"], disc["xy"]), size * math.hypot(disc["xx"], disc["yx"])


@njit(cache=True, nogil=True, error_model="numpy")
def _set_box_kernel(before: Any, after: Any, slack_px: float, box: Any) -> None:
    """Write the box that a marker sweeps with a margin, not clipped to the sensor."""
    (ax, ay), (bx, by) = _half_size_kernel(before), _half_size_kernel(after)
    box["x_first"] = math.floor(min(before["x"] - ax, after["x"] - bx) - slack_px)
    box["x_last"] = math.ceil(max(before["x"] + ax, after["x"] + bx) + slack_px)
    box["y_first"] = math.floor(min(before["y"] - ay, after["y"] - by) - slack_px)
    box["y_last"] = math.ceil(max(before["y"] + ay, after["y"] + by) + slack_px)
    if before["radius"] <= 0.0 and after["radius"] <= 0.0:
        box["x_last"], box["y_last"] = box["x_first"] - 1, box["y_first"] - 1


@njit(cache=True, nogil=True, error_model="numpy")
def coverage_image_kernel(discs: NDArray[Any], chip: Any, coverage: NDArray[np.float32]) -> None:
    """Write the fractions ``(height, width)`` of the pixels that ``(m,)`` markers cover."""
    coverage[:, :] = 0.0
    height, width = coverage.shape
    box = np.empty(1, SWEEP_PLAN_DTYPE)[0]
    for disc in discs:
        _set_box_kernel(disc, disc, chip["edge_half_width_px"] + 1.0, box)
        for y in range(max(box["y_first"], 0), min(box["y_last"], height - 1) + 1):
            for x in range(max(box["x_first"], 0), min(box["x_last"], width - 1) + 1):
                covered = disc_coverage_kernel(disc, chip, float(x), float(y))
                coverage[y, x] = max(coverage[y, x], covered)


@njit(cache=True, nogil=True, error_model="numpy")
def plan_sweep_kernel(
    before: NDArray[Any],
    after: NDArray[Any],
    reach_px: float,
    span_us: float,
    limits: tuple[float, float],
    plan: NDArray[Any],
) -> None:
    """Plan how the markers are rendered between two images.

    Args:
        before: ``(m,)`` markers as they were last rendered.
        after: ``(m,)`` markers at the end.
        reach_px: Half-width of a marker's blurred edge, px.
        span_us: Time between the images, us.
        limits: Longest step, us, and the motion below which a marker is not rendered, px.
        plan: ``(m,)`` records of :data:`SWEEP_PLAN_DTYPE`, overwritten.
    """
    moving = np.zeros(len(plan), np.bool_)
    for k in range(len(plan)):
        old, new, item = before[k], after[k], plan[k]
        # The largest travel of the edge, to first order in the strain.
        strain = max(abs(new["xx"] - old["xx"]), abs(new["xy"] - old["xy"]))
        strain = max(strain, abs(new["yx"] - old["yx"]), abs(new["yy"] - old["yy"]))
        shift_px = math.hypot(new["x"] - old["x"], new["y"] - old["y"])
        travel_px = shift_px + 2 * strain * new["radius"] + abs(new["radius"] - old["radius"])
        moving[k] = travel_px > limits[1]
        steps = min(math.ceil(travel_px / STEP_PX), math.floor(span_us / SHORTEST_STEP_US))
        item["steps"] = max(steps, 1, math.ceil(span_us / limits[0]))
        item["margin_px"] = travel_px / item["steps"] + _MARGIN_PX
        _set_box_kernel(old, new, reach_px + item["margin_px"], item)
    _group_kernel(plan, moving)


@njit(cache=True, nogil=True, error_model="numpy")
def _group_kernel(plan: NDArray[Any], moving: NDArray[np.bool_]) -> None:
    """Group the markers whose boxes overlap, and link the groups in which one moves."""
    for a in range(len(plan)):
        plan[a]["leader"], plan[a]["following"] = a, -1
        for b in range(a):
            one, two = plan[a]["leader"], plan[b]["leader"]
            if one != two and _overlap_kernel(plan[a], plan[b]):
                for c in range(a + 1):  # the group with the higher leader joins the other
                    if plan[c]["leader"] == max(one, two):
                        plan[c]["leader"] = min(one, two)
    for k in range(len(plan)):
        moving[plan[k]["leader"]] |= moving[k]
    last = np.empty(len(plan), np.int64)
    for k in range(len(plan)):
        leader = plan[k]["leader"]
        if not moving[leader]:
            plan[k]["leader"] = -1
        elif leader != k:
            plan[last[leader]]["following"] = k
            plan[leader]["steps"] = max(plan[leader]["steps"], plan[k]["steps"])
        last[leader] = k


@njit(cache=True, nogil=True, error_model="numpy")
def _overlap_kernel(one: Any, two: Any) -> bool:
    meet_x = one["x_first"] <= two["x_last"] and two["x_first"] <= one["x_last"]
    meet_y = one["y_first"] <= two["y_last"] and two["y_first"] <= one["y_last"]
    there = one["x_last"] >= one["x_first"] and two["x_last"] >= two["x_first"]
    return meet_x and meet_y and there
