"""Move the markers over the pixels: only those near a moving edge are visited."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.pixel_coverage import coverage_kernel, edge_kernel
from spikingtac.sim.camera.pixels import (
    carry_kernel,
    cross_kernel,
    foresee_kernel,
    hold_kernel,
    intensity_kernel,
    quiet_kernel,
    relight_kernel,
    unchanged_kernel,
)
from spikingtac.sim.camera.sensor import Sensor


class Motion(NamedTuple):
    """The markers between two images.

    Attributes:
        before: ``(m,)`` discs as last rendered; moved on to the end of what was rendered.
        after: ``(m,)`` discs at the end.
        now: ``(m,)`` scratch.
        work: ``(m,)`` what :func:`~spikingtac.sim.camera.sweep_plan.plan_kernel` found.
        start_us: Time of the first image.
        end_us: Time of the second.
    """

    before: NDArray[Any]
    after: NDArray[Any]
    now: NDArray[Any]
    work: NDArray[Any]
    start_us: float
    end_us: float


@njit(cache=True, nogil=True, error_model="numpy")
def _group_coverage_kernel(motion: Motion, k: int, chip: Any, x: float, y: float) -> float:
    """Return the coverage by the marker of ``k``'s group that covers the pixel most."""
    covered = 0.0
    member = motion.work[k]["leader"]
    while member >= 0:
        covered = max(covered, coverage_kernel(motion.now[member], chip, x, y))
        member = motion.work[member]["following"]
    return covered


@njit(cache=True, nogil=True, error_model="numpy")
def place_kernel(before: Any, after: Any, share: float, now: Any) -> None:
    """Write a marker at a share of the way into ``now``."""
    rest = 1.0 - share
    now["x"] = rest * before["x"] + share * after["x"]
    now["y"] = rest * before["y"] + share * after["y"]
    now["xx"] = rest * before["xx"] + share * after["xx"]
    now["xy"] = rest * before["xy"] + share * after["xy"]
    now["yx"] = rest * before["yx"] + share * after["yx"]
    now["yy"] = rest * before["yy"] + share * after["yy"]
    now["radius"] = rest * before["radius"] + share * after["radius"]
    now["scale"] = math.sqrt(abs(now["xx"] * now["yy"] - now["xy"] * now["yx"]))
    now["cut_x"], now["cut_y"], now["cut"] = after["cut_x"], after["cut_y"], after["cut"]


@njit(cache=True, nogil=True, error_model="numpy")
def _edge_pixels_kernel(
    sensor: Sensor, motion: Motion, out: NDArray[np.int64], k: int, start_us: float, end_us: float
) -> None:
    """Show the present light to the pixels around marker ``k``'s edge."""
    pixels, chip = sensor.pixels, sensor.chip[0]
    waiting, count, shown = sensor.agenda.waiting, sensor.agenda.listed, sensor.agenda.shown
    disc, box = motion.now[k], motion.work[k]
    radius, scale = disc["radius"], disc["scale"]
    visited = (chip["reach_px"] + box["margin_px"]) * scale
    outer = (radius + visited) ** 2
    whole = disc["cut"] >= radius
    inner = max(radius - visited, 0.0) ** 2 if whole else 0.0
    shrink, span_us = 1.0 / scale, end_us - start_us
    alone = box["leader"] == k and box["following"] < 0
    for y in range(max(box["y_first"], 0), min(box["y_last"] + 1, pixels.shape[0])):
        dy = y - disc["y"]
        for x in range(max(box["x_first"], 0), min(box["x_last"] + 1, pixels.shape[1])):
            dx = x - disc["x"]
            u, v = disc["xx"] * dx + disc["xy"] * dy, disc["yx"] * dx + disc["yy"] * dy
            square = u * u + v * v
            if square > outer or square < inner:
                continue
            if alone and whole:
                covered = edge_kernel(chip, (radius - math.sqrt(square)) * shrink)
            else:
                covered = _group_coverage_kernel(motion, k, chip, float(x), float(y))
            px = pixels[y, x]
            light = intensity_kernel(px, covered)
            if unchanged_kernel(px, light):
                continue
            if not carry_kernel(px, start_us):
                hold_kernel(px, chip, out, start_us)
            rise = relight_kernel(px, chip, light, end_us, span_us)
            if not quiet_kernel(px, start_us, rise):
                cross_kernel(px, chip, out, start_us, span_us, rise)
            if px["listed"] == 0:
                px["listed"] = 1
                waiting[count[0]] = px["index"]
                count[0] += 1
            if end_us == motion.end_us and not foresee_kernel(px):
                shown[px["index"]] = 1


@njit(cache=True, nogil=True, error_model="numpy")
def _move_group_kernel(sensor: Sensor, motion: Motion, out: NDArray[np.int64], leader: int) -> None:
    """Move the markers of one group from the first image to the second."""
    work = motion.work
    steps = work[leader]["steps"]
    step_us = (motion.end_us - motion.start_us) / steps
    start_us = motion.start_us
    for step in range(steps):
        last = step == steps - 1
        end_us = motion.end_us if last else motion.start_us + (step + 1) * step_us
        k = leader
        while k >= 0:
            share = 1.0 if last else (step + 1) / steps
            place_kernel(motion.before[k], motion.after[k], share, motion.now[k])
            k = work[k]["following"]
        k = leader
        while k >= 0:
            _edge_pixels_kernel(sensor, motion, out, k, start_us, end_us)
            k = work[k]["following"]
        start_us = end_us


@njit(cache=True, nogil=True, error_model="numpy")
def _settle_kernel(sensor: Sensor, out: NDArray[np.int64], until_us: float) -> None:
    """Carry the unsettled pixels to the end of the interval; keep those still unsettled."""
    pixels, chip, agenda = sensor.pixels, sensor.chip[0], sensor.agenda
    waiting, shown = agenda.waiting, agenda.shown
    kept = 0
    for n in range(agenda.listed[0]):
        place = waiting[n]
        if shown[place] == 0:
            row, column = divmod(place, pixels.shape[1])
            px = pixels[row, column]
            if not carry_kernel(px, until_us):
                hold_kernel(px, chip, out, until_us)
            if foresee_kernel(px):
                px["listed"] = 0
                agenda.row_due_us[row] = min(agenda.row_due_us[row], px["due_us"])
                continue
        shown[place] = 0
        waiting[kept] = place
        kept += 1
    agenda.listed[0] = kept


@njit(cache=True, nogil=True, error_model="numpy")
def _leak_kernel(sensor: Sensor, out: NDArray[np.int64], until_us: float) -> None:
    """Let the resting pixels fire whose leak reaches the threshold in this interval."""
    pixels, chip, row_due_us = sensor.pixels, sensor.chip[0], sensor.agenda.row_due_us
    for row in range(pixels.shape[0]):
        if row_due_us[row] >= until_us:
            continue
        due_us = np.inf
        for column in range(pixels.shape[1]):
            px = pixels[row, column]
            if px["due_us"] < until_us:
                hold_kernel(px, chip, out, until_us)
                foresee_kernel(px)
            due_us = min(due_us, px["due_us"])
        row_due_us[row] = due_us


@njit(cache=True, nogil=True, error_model="numpy")
def sweep_kernel(sensor: Sensor, motion: Motion, out: NDArray[np.int64]) -> None:
    """Render the motion between two images; the keys of all events that it causes follow out[0]."""
    work = motion.work
    for leader in range(work.shape[0]):
        if work[leader]["leader"] == leader:
            _move_group_kernel(sensor, motion, out, leader)
    for k in range(work.shape[0]):
        if work[k]["leader"] >= 0:
            motion.before[k] = motion.after[k]
    _settle_kernel(sensor, out, motion.end_us)
    _leak_kernel(sensor, out, motion.end_us)
