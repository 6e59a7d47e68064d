"""Markers on the sensor: what they cover, and how their motion between two images is planned.

Fraction of each pixel that the markers cover.

Plan of a sweep: which markers move, which of them share pixels, and how many steps they take.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.arrays import FloatArray
from spikingtac.sim.camera.config import StepConfig
from spikingtac.sim.camera.pixel_records import EDGE_ENTRIES
from spikingtac.sim.states import MarkerImage

# One marker on the sensor.
DISC_DTYPE = np.dtype(
    [
        ("x", "f8"),  # centre, px
        ("y", "f8"),
        ("xx", "f8"),  # shape, see MarkerImage: undeformed = (xx dx + xy dy, yx dx + yy dy)
        ("xy", "f8"),
        ("yx", "f8"),
        ("yy", "f8"),
        ("radius", "f8"),  # px, 0 where no marker is
        ("scale", "f8"),  # undeformed px in one px of the sensor
        ("chord_x", "f8"),  # what is left of a broken disc, see MarkerImage.chord
        ("chord_y", "f8"),
        ("chord_px", "f8"),
    ],
    align=True,
)


def discs_of(image: MarkerImage) -> NDArray[Any]:
    """Return the markers of an image as ``(m,)`` records of :data:`DISC_DTYPE`."""
    discs = np.empty(len(image.center_px), DISC_DTYPE)
    chord = (0.0, 0.0, np.inf) if image.chord is None else np.asarray(image.chord).T
    (xx, xy), (yx, yy) = np.asarray(image.shape, np.float64).transpose(1, 2, 0)
    scale = np.sqrt(np.abs(xx * yy - xy * yx))
    columns = *np.asarray(image.center_px).T, xx, xy, yx, yy, image.radius_px, scale, *chord
    for name, column in zip(DISC_DTYPE.names or (), columns, strict=True):
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
    covered = edge_coverage_kernel(
        chip, (disc["radius"] - math.sqrt(u * u + v * v)) / disc["scale"]
    )
    if disc["chord_px"] < disc["radius"]:
        left = disc["chord_px"] - disc["chord_x"] * u - disc["chord_y"] * v
        covered *= edge_coverage_kernel(chip, left / disc["scale"])
    return covered if disc["radius"] > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def coverage_image_kernel(
    discs: NDArray[Any], plan: NDArray[Any], chip: Any, coverage: NDArray[np.float32]
) -> None:
    """Write the coverage of every pixel, ``(height, width)``.

    Args:
        discs: ``(m,)`` markers.
        plan: ``(m,)`` bounding boxes, see
            :data:`~spikingtac.sim.camera.coverage.SWEEP_PLAN_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixel_records.CHIP_DTYPE`.
        coverage: ``(height, width)`` fractions, overwritten.
    """
    coverage[:, :] = 0.0
    height, width = coverage.shape
    for k in range(discs.shape[0]):
        disc, box = discs[k], plan[k]
        for y in range(max(box["y_first"], 0), min(box["y_last"], height - 1) + 1):
            for x in range(max(box["x_first"], 0), min(box["x_last"], width - 1) + 1):
                covered = disc_coverage_kernel(disc, chip, float(x), float(y))
                coverage[y, x] = max(coverage[y, x], covered)


# Margin around an edge, so that pixels see zero and full coverage before the edge passes.
_MARGIN_PX = 0.1

STEP_PX = 0.1  # Longest travel of a marker's edge in one step, px (reference twin.md).
SHORTEST_STEP_US = 20.0  # Shortest step, us. Faster motions travel further in one step.

# How one marker is rendered between two images.
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


def plan_sweep(
    before: NDArray[Any], after: NDArray[Any], reach_px: float, span_us: float, steps: StepConfig
) -> NDArray[Any]:
    """Return how the markers are rendered between two images, ``(m,)`` :data:`SWEEP_PLAN_DTYPE`.

    Args:
        before: ``(m,)`` markers as they were last rendered.
        after: ``(m,)`` markers at the end.
        reach_px: Half-width of a marker's blurred edge, px.
        span_us: Time between the images, us.
        steps: Longest step, and the motion below which a marker is not rendered.
    """
    plan = np.empty(len(after), SWEEP_PLAN_DTYPE)
    travel_px = _edge_travel_px(before, after)
    by_travel = np.minimum(np.ceil(travel_px / STEP_PX), math.floor(span_us / SHORTEST_STEP_US))
    plan["steps"] = np.maximum(by_travel, max(1, math.ceil(span_us / steps.max_us)))
    plan["margin_px"] = travel_px / plan["steps"] + _MARGIN_PX
    set_boxes(plan, before, after, reach_px + plan["margin_px"])
    plan["leader"] = plan["following"] = -1
    moving = travel_px > steps.still_px
    if not moving.any():
        return plan
    plan["leader"] = leader = _leaders(plan, moving)
    members = np.flatnonzero(leader >= 0)
    members = members[np.argsort(leader[members], kind="stable")]
    same = leader[members[1:]] == leader[members[:-1]]
    plan["following"][members[:-1][same]] = members[1:][same]
    np.maximum.at(plan["steps"], leader[members], plan["steps"][members])
    return plan


def _edge_travel_px(before: NDArray[Any], after: NDArray[Any]) -> FloatArray:
    """Return the largest travel of each marker's edge, px (to first order in the strain)."""
    shift = np.hypot(after["x"] - before["x"], after["y"] - before["y"])
    changes = [np.abs(after[name] - before[name]) for name in ("xx", "xy", "yx", "yy")]
    strain = np.maximum.reduce(changes)
    return shift + 2 * strain * after["radius"] + np.abs(after["radius"] - before["radius"])


def set_boxes(
    plan: NDArray[Any], before: NDArray[Any], after: NDArray[Any], slack_px: FloatArray | float
) -> None:
    """Write the boxes that the markers sweep with a margin, not clipped to the sensor."""
    halves = []
    for discs in (before, after):
        size = discs["radius"] / discs["scale"] ** 2
        halves.append((size * np.hypot(discs["yy"], discs["xy"]),
                       size * np.hypot(discs["xx"], discs["yx"])))  # fmt: skip
    gone = (before["radius"] <= 0.0) & (after["radius"] <= 0.0)
    for axis, name in enumerate("xy"):
        half, half_after = halves[0][axis], halves[1][axis]
        low = np.minimum(before[name] - half, after[name] - half_after) - slack_px
        high = np.maximum(before[name] + half, after[name] + half_after) + slack_px
        plan[f"{name}_first"] = np.floor(low)
        plan[f"{name}_last"] = np.where(gone, plan[f"{name}_first"] - 1, np.ceil(high))


def _leaders(plan: NDArray[Any], moving: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the lowest of the markers with overlapping boxes if one of them moves, else -1."""
    markers = len(plan)
    there = plan["x_last"] >= plan["x_first"]
    meet = there[:, None] & there
    for name in "xy":
        begins = plan[f"{name}_first"][:, None] <= plan[f"{name}_last"]
        meet &= begins & begins.T
    lowest = np.arange(markers)
    while True:
        lower = np.minimum(lowest, np.where(meet, lowest, markers).min(axis=1, initial=markers))
        if (lower == lowest).all():
            break
        lowest = lower
    moved = np.zeros(markers, np.bool_)
    moved[lowest[moving]] = True
    return np.where(moved[lowest], lowest, -1)


def swept_pixel_count(plan: NDArray[Any], width: int, height: int) -> int:
    """Return an upper bound of the number of pixels in the boxes of the moving markers.

    The boxes are clipped to the sensor: a tip that is pushed much too far moves markers far beyond
    the sensor, or across all of it.
    """
    box = plan[plan["leader"] >= 0]
    rows = np.minimum(box["y_last"], height - 1) - np.maximum(box["y_first"], 0) + 1
    columns = np.minimum(box["x_last"], width - 1) - np.maximum(box["x_first"], 0) + 1
    return min(int((rows.clip(0) * columns.clip(0)).sum()), width * height)
