"""Render moving markers: only the pixels near a moving edge are computed step by step.

All other pixels see constant light, under which their state advances in closed form.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.coverage import (
    disc_coverage_kernel,
    edge_coverage_kernel,
    plan_sweep_kernel,
)
from spikingtac.sim.camera.pixels import (
    SAME_LIGHT,
    advance_constant_light_kernel,
    advance_light_ramp_kernel,
    advance_settled_kernel,
    change_below_threshold_kernel,
    emit_crossings_kernel,
    intensity_kernel,
    predict_leak_event_kernel,
)
from spikingtac.sim.camera.sensor import Sensor


class MarkerSweep(NamedTuple):
    """Motion of the markers between two images.

    Attributes:
        before: ``(m,)`` discs as last rendered; overwritten by the discs at the end.
        after: ``(m,)`` discs at the end.
        now: ``(m,)`` work space for the discs at the present step.
        plan: ``(m,)`` work space of :func:`~spikingtac.sim.camera.coverage.plan_sweep_kernel`.
        start_us: Time of the first image, us.
        end_us: Time of the second image, us.
    """

    before: NDArray[Any]
    after: NDArray[Any]
    now: NDArray[Any]
    plan: NDArray[Any]
    start_us: float
    end_us: float


@njit(cache=True, nogil=True, error_model="numpy")
def interpolate_disc_kernel(before: Any, after: Any, fraction: float, now: Any) -> None:
    """Write a marker, interpolated between two images at ``fraction`` (0 to 1), into ``now``."""
    rest = 1.0 - fraction
    now["x"] = rest * before["x"] + fraction * after["x"]
    now["y"] = rest * before["y"] + fraction * after["y"]
    now["xx"] = rest * before["xx"] + fraction * after["xx"]
    now["xy"] = rest * before["xy"] + fraction * after["xy"]
    now["yx"] = rest * before["yx"] + fraction * after["yx"]
    now["yy"] = rest * before["yy"] + fraction * after["yy"]
    now["radius"] = rest * before["radius"] + fraction * after["radius"]
    now["scale"] = math.sqrt(abs(now["xx"] * now["yy"] - now["xy"] * now["yx"]))
    now["chord_x"], now["chord_y"] = after["chord_x"], after["chord_y"]
    now["chord_px"] = after["chord_px"]


@njit(cache=True, nogil=True, error_model="numpy")
def _update_edge_pixels_kernel(
    sensor: Sensor, sweep: MarkerSweep, out: NDArray[np.int64], k: int, times: tuple[float, float]
) -> None:
    """Update the pixels around the edge of marker ``k`` from ``times[0]`` to ``times[1]``, us."""
    start_us, end_us = times
    pixels, chip = sensor.pixels, sensor.chip[0]
    disc, box = sweep.now[k], sweep.plan[k]
    radius, scale = disc["radius"], disc["scale"]
    visited = (chip["edge_half_width_px"] + box["margin_px"]) * scale
    outer = (radius + visited) ** 2
    whole = disc["chord_px"] >= radius
    inner = max(radius - visited, 0.0) ** 2 if whole else 0.0
    shrink, span_us = 1.0 / scale, end_us - start_us
    alone = whole and box["leader"] == k and box["following"] < 0
    for y in range(max(box["y_first"], 0), min(box["y_last"] + 1, pixels.shape[0])):
        dy = y - disc["y"]
        for x in range(max(box["x_first"], 0), min(box["x_last"] + 1, pixels.shape[1])):
            dx = x - disc["x"]
            u, v = disc["xx"] * dx + disc["xy"] * dy, disc["yx"] * dx + disc["yy"] * dy
            square = u * u + v * v
            if square > outer or square < inner:
                continue
            if alone:
                covered = edge_coverage_kernel(chip, (radius - math.sqrt(square)) * shrink)
            else:
                covered = _group_coverage_kernel(sweep, k, chip, float(x), float(y))
            px = pixels[y, x]
            light = intensity_kernel(px, covered)
            if abs(light - px["intensity"]) < SAME_LIGHT:
                continue
            if not advance_settled_kernel(px, start_us):
                advance_constant_light_kernel(px, chip, out, start_us)
            rise = advance_light_ramp_kernel(px, chip, light, end_us, span_us)
            if not change_below_threshold_kernel(px, start_us, rise):
                emit_crossings_kernel(px, chip, out, start_us, span_us, rise)
            if px["queued"] == 0:
                px["queued"] = 1
                sensor.unsettled[sensor.unsettled_count[0]] = px["index"]
                sensor.unsettled_count[0] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _group_coverage_kernel(sweep: MarkerSweep, k: int, chip: Any, x: float, y: float) -> float:
    """Return the largest coverage of a pixel by any marker of the group of ``k``."""
    covered = 0.0
    member = sweep.plan[k]["leader"]
    while member >= 0:
        covered = max(covered, disc_coverage_kernel(sweep.now[member], chip, x, y))
        member = sweep.plan[member]["following"]
    return covered


@njit(cache=True, nogil=True, error_model="numpy")
def _move_group_kernel(
    sensor: Sensor, sweep: MarkerSweep, out: NDArray[np.int64], leader: int
) -> None:
    """Move the markers of one group from the first image to the second, step by step."""
    steps = sweep.plan[leader]["steps"]
    step_us = (sweep.end_us - sweep.start_us) / steps
    start_us = sweep.start_us
    for step in range(steps):
        last = step == steps - 1
        end_us = sweep.end_us if last else sweep.start_us + (step + 1) * step_us
        fraction = 1.0 if last else (step + 1) / steps
        k = leader
        while k >= 0:
            interpolate_disc_kernel(sweep.before[k], sweep.after[k], fraction, sweep.now[k])
            k = sweep.plan[k]["following"]
        k = leader
        while k >= 0:
            _update_edge_pixels_kernel(sensor, sweep, out, k, (start_us, end_us))
            k = sweep.plan[k]["following"]
        start_us = end_us


@njit(cache=True, nogil=True, error_model="numpy")
def _advance_unsettled_kernel(sensor: Sensor, out: NDArray[np.int64], until_us: float) -> None:
    """Advance the unsettled pixels to the end of the interval. Drop those that have settled."""
    pixels, chip, unsettled, kept = sensor.pixels, sensor.chip[0], sensor.unsettled, 0
    for n in range(sensor.unsettled_count[0]):
        row, column = divmod(unsettled[n], pixels.shape[1])
        px = pixels[row, column]
        if not advance_settled_kernel(px, until_us):
            advance_constant_light_kernel(px, chip, out, until_us)
        if predict_leak_event_kernel(px):
            px["queued"] = 0
            sensor.row_leak_due_us[row] = min(sensor.row_leak_due_us[row], px["leak_due_us"])
        else:
            unsettled[kept] = unsettled[n]
            kept += 1
    sensor.unsettled_count[0] = kept


@njit(cache=True, nogil=True, error_model="numpy")
def _emit_leak_events_kernel(sensor: Sensor, out: NDArray[np.int64], until_us: float) -> None:
    """Emit the leak events of resting pixels that are due in this interval."""
    pixels, chip, row_leak_due_us = sensor.pixels, sensor.chip[0], sensor.row_leak_due_us
    for row in range(pixels.shape[0]):
        if row_leak_due_us[row] >= until_us:
            continue
        due_us = np.inf
        for column in range(pixels.shape[1]):
            px = pixels[row, column]
            if px["leak_due_us"] < until_us:
                advance_constant_light_kernel(px, chip, out, until_us)
                predict_leak_event_kernel(px)
            due_us = min(due_us, px["leak_due_us"])
        row_leak_due_us[row] = due_us


@njit(cache=True, nogil=True, error_model="numpy")
def sweep_kernel(
    sensor: Sensor, sweep: MarkerSweep, limits: tuple[float, float], out: NDArray[np.int64]
) -> None:
    """Render the motion between two images; the pixels near moving edges are visited.

    Args:
        sensor: State of the pixels, advanced to the end of the sweep.
        sweep: Motion of the markers.
        limits: Longest step, us, and the motion below which a marker is not rendered, px.
        out: ``out[0]`` counts the events, whose keys follow.
    """
    plan, reach_px = sweep.plan, sensor.chip[0]["edge_half_width_px"]
    span_us = sweep.end_us - sweep.start_us
    plan_sweep_kernel(sweep.before, sweep.after, reach_px, span_us, limits, plan)
    for leader in range(plan.shape[0]):
        if plan[leader]["leader"] == leader:
            _move_group_kernel(sensor, sweep, out, leader)
    for k in range(plan.shape[0]):
        if plan[k]["leader"] >= 0:
            sweep.before[k] = sweep.after[k]
    _advance_unsettled_kernel(sensor, out, sweep.end_us)
    _emit_leak_events_kernel(sensor, out, sweep.end_us)
