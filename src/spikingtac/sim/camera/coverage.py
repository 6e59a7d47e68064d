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

from spikingtac.sim.camera.pixel_records import EDGE_ENTRIES
from spikingtac.sim.states import MarkerImage

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
"""One marker on the sensor."""


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


_MARGIN_PX = 0.1
"""Margin around an edge, so that pixels see zero and full coverage before the edge passes."""

STEP_PX = 0.1
"""Longest travel of a marker's edge in one step, px (reference twin.md)."""
SHORTEST_STEP_US = 20.0
"""Shortest step, us. Faster motions travel further in one step."""

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
        before: Record of :data:`~spikingtac.sim.camera.coverage.DISC_DTYPE` at the start.
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
    max_us: float,
    still_px: float,
) -> None:
    """Plan how the markers are rendered between two images.

    Args:
        before: ``(m,)`` markers as they were last rendered.
        after: ``(m,)`` markers at the end.
        plan: ``(m,)`` records of :data:`SWEEP_PLAN_DTYPE`, overwritten.
        edge_half_width_px: Half-width of a marker's blurred edge, px.
        span_us: Time between the images, us.
        max_us: Longest step, us.
        still_px: Motion below which a marker is not rendered, px; see
            :class:`~spikingtac.sim.camera.config.StepConfig`.
    """
    for k in range(plan.shape[0]):
        item = plan[k]
        travel_px = edge_travel_kernel(before[k], after[k])
        item["leader"] = k if travel_px > still_px else -1
        steps = min(math.ceil(travel_px / STEP_PX), math.floor(span_us / SHORTEST_STEP_US))
        item["steps"] = max(1, steps, math.ceil(span_us / max_us))
        item["margin_px"] = travel_px / item["steps"] + _MARGIN_PX
        bounding_box_kernel(before[k], after[k], edge_half_width_px + item["margin_px"], item)
    _group_overlapping_kernel(plan)
    _link_groups_kernel(plan)


def swept_pixel_count(plan: NDArray[Any], width: int, height: int) -> int:
    """Return an upper bound of the number of pixels in the boxes of the moving markers.

    The boxes are clipped to the sensor: a tip that is pushed much too far moves markers far beyond
    the sensor, or across all of it.
    """
    box = plan[plan["leader"] >= 0]
    rows = np.minimum(box["y_last"], height - 1) - np.maximum(box["y_first"], 0) + 1
    columns = np.minimum(box["x_last"], width - 1) - np.maximum(box["x_first"], 0) + 1
    return min(int((rows.clip(0) * columns.clip(0)).sum()), width * height)
