"""Pixels under markers that sway a little: visited only while they are close to an event.

A marker that sways by a tenth of a pixel changes the light of the pixels around its edge by a
share of a threshold. Each pixel's distance to the edge is linear in the rod's motion, its light is
looked up, and the change detector is that of :mod:`spikingtac.sim.camera.pixels`. A pixel whose
change detector cannot reach a threshold for a while sleeps for that while, which makes this fast.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.pixel_coverage import edge_kernel
from spikingtac.sim.camera.pixels import cross_kernel, intensity_kernel, log_kernel, quiet_kernel
from spikingtac.sim.free_motion.timing_wheel import TimingWheel, pop_due_kernel, schedule_kernel

EDGE_DTYPE = np.dtype(
    [
        ("inside_px", "f4"),  # distance inside the edge at rest
        ("lowest", "f4"),  # log light that the sway does not leave
        ("highest", "f4"),
        ("lag", "i4"),  # which of the low-passed motions the pixel follows
        ("from_px", "f4"),  # while the distance stays between these two, nothing happens
        ("to_px", "f4"),
        ("until_us", "f8"),  # at least up to this time
        ("slope", "f4", (6,)),  # change of the distance per unit of the bushing, px/mm and px/rad
    ],
    align=True,
)
"""A pixel near an edge: one record, so that one look at it touches one place in memory."""

BAND_STEPS = 64
"""For so many steps a band of distances is worked out; a longer wait is slept through."""
LEAST_SLEEP_STEPS = 2.0
ROW_STEPS = 16
"""Steps of the motion that are looked at together."""
_HALVINGS = 12
"""Steps of the bisection for a band's ends: a thousandth of a pixel, and always inside."""


class Rims(NamedTuple):
    """The pixels near edges.

    Attributes:
        edges: ``(e,)`` of :data:`EDGE_DTYPE`.
        place: ``(n,)`` where each pixel stands among them; -1 away from every edge.
    """

    edges: NDArray[Any]
    place: NDArray[np.int32]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def swayed_px_kernel(edge: Any, motion: NDArray[np.float32], step: int) -> float:
    """Return how far inside the edge a pixel lies at a step of the motion, px."""
    inside = float(edge["inside_px"])
    lag = edge["lag"]
    for freedom in range(6):
        inside += float(edge["slope"][freedom]) * float(motion[lag, freedom, step])
    return inside


@njit(cache=True, nogil=True, error_model="numpy")
def level_kernel(px: Any, chip: Any, inside_px: float) -> float:
    """Return the log light of a pixel at a distance inside the edge."""
    return log_kernel(chip, intensity_kernel(px, edge_kernel(chip, inside_px)))


@njit(cache=True, nogil=True, error_model="numpy")
def reach_kernel(px: Any, chip: Any, here_px: float, level: float, towards: float) -> float:
    """Return a distance from ``here_px`` on at which the level is not yet reached.

    Args:
        px: Record of :data:`~spikingtac.sim.camera.pixels.PIXEL_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixels.CHIP_DTYPE`.
        here_px: Where the pixel is now.
        level: Log light that must not be passed.
        towards: 1 to look further inside, -1 to look outwards.
    """
    rising = px["lift"] * towards > 0.0
    near = here_px
    far = here_px + towards * 4.0 * chip["reach_px"]
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        found = level_kernel(px, chip, middle)
        if (found < level) if rising else (found > level):
            near = middle
        else:
            far = middle
    return near


@njit(cache=True, nogil=True, error_model="numpy")
def band_kernel(px: Any, edge: Any, chip: Any, inside_px: float, span_us: float) -> None:
    """Note between which distances a pixel cannot fire for the next ``span_us``."""
    edge["until_us"] = -np.inf
    top = px["level"] + px["on"] - px["gap"] - px["leak"] * span_us
    bottom = px["level"] - px["off"] - px["gap"]
    if px["dead_us"] > px["seen_us"] or not bottom < px["level"] < top:
        return
    side = 1.0 if px["lift"] > 0.0 else -1.0
    one = reach_kernel(px, chip, inside_px, top, side)
    two = reach_kernel(px, chip, inside_px, bottom, -side)
    edge["from_px"], edge["to_px"] = min(one, two), max(one, two)
    edge["until_us"] = px["seen_us"] + span_us


@njit(cache=True, nogil=True, error_model="numpy")
def sleep_kernel(px: Any, lowest: float, highest: float) -> float:
    """Return for how long a pixel cannot fire while its level stays between two limits, us.

    Zero where it may fire at any time; infinite where nothing moves it.
    """
    if px["dead_us"] > px["seen_us"] or px["gap"] - (px["level"] - lowest) <= -px["off"]:
        return 0.0
    room = px["on"] - px["gap"] - (highest - px["level"])
    if room <= 0.0:
        return 0.0
    return room / px["leak"] if px["leak"] > 0.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def carry_level_kernel(px: Any, level: float, until_us: float) -> None:
    """Carry a pixel that cannot have fired to ``until_us``."""
    if px["seen_us"] < until_us:
        px["gap"] += level - px["level"] + px["leak"] * (until_us - px["seen_us"])
        px["level"], px["seen_us"] = level, until_us


@njit(cache=True, nogil=True, error_model="numpy")
def visit_kernel(px: Any, chip: Any, level: float, until_us: float, out: NDArray[np.int64]) -> None:
    """Carry a pixel to ``until_us`` while its level moves evenly to ``level``."""
    seen_us = px["seen_us"]
    span_us = until_us - seen_us
    rise = level - px["level"] + px["leak"] * span_us
    if not quiet_kernel(px, seen_us, rise):
        cross_kernel(px, chip, out, seen_us, span_us, rise)
    px["level"], px["seen_us"] = level, until_us


@njit(cache=True, nogil=True, error_model="numpy")
def ground_kernel(px: Any, chip: Any, times: tuple[float, float], out: NDArray[np.int64]) -> float:
    """Visit a pixel away from every edge; return for how long it sleeps, us."""
    level = float(px["level"])
    carry_level_kernel(px, level, times[0])
    visit_kernel(px, chip, level, times[1], out)
    return sleep_kernel(px, level, level)


@njit(cache=True, nogil=True, error_model="numpy")
def rim_kernel(
    px: Any,
    edge: Any,
    chip: Any,
    before_px: float,
    inside_px: float,
    times: tuple[float, float],
    out: NDArray[np.int64],
) -> float:
    """Visit a pixel near an edge; return for how long it sleeps, us; zero while a band holds it.

    Args:
        px: Record of :data:`~spikingtac.sim.camera.pixels.PIXEL_DTYPE`.
        edge: Record of :data:`EDGE_DTYPE`.
        chip: Record of :data:`~spikingtac.sim.camera.pixels.CHIP_DTYPE`.
        before_px: How far inside the edge it lay at the step's beginning.
        inside_px: The same at its end.
        times: Beginning and end of the step, us.
        out: ``out[0]`` counts the events, whose keys follow.
    """
    band_us = BAND_STEPS * (times[1] - times[0])
    carry_level_kernel(px, level_kernel(px, chip, before_px), times[0])
    visit_kernel(px, chip, level_kernel(px, chip, inside_px), times[1], out)
    asleep_us = sleep_kernel(px, float(edge["lowest"]), float(edge["highest"]))
    if asleep_us > band_us:
        edge["until_us"] = -np.inf
        return asleep_us
    band_kernel(px, edge, chip, inside_px, band_us)
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def stay_kernel(
    edge: Any, motion: NDArray[np.float32], step: int, start_us: float, step_us: float
) -> int:
    """Return for how many steps from ``step`` on a pixel needs no visit, as far as is known.

    Rows of steps are looked at together, unsigned and written out, for the compiler to do several
    at once: it does so neither with a loop over the freedoms nor where an index may be negative.
    """
    if edge["until_us"] < start_us + step * step_us:
        return 0
    end = 1 + min(int((edge["until_us"] - start_us) / step_us), motion.shape[2] - 1)
    rest, low, high = float(edge["inside_px"]), float(edge["from_px"]), float(edge["to_px"])
    lag, slope, now = np.uint64(edge["lag"]), edge["slope"], step
    a, b, c = float(slope[0]), float(slope[1]), float(slope[2])
    d, e, f = float(slope[3]), float(slope[4]), float(slope[5])
    while now + ROW_STEPS <= end:
        outside = 0
        for k in range(np.uint64(now), np.uint64(now + ROW_STEPS)):
            inside = rest + a * float(motion[lag, 0, k])
            inside += b * float(motion[lag, 1, k])
            inside += c * float(motion[lag, 2, k])
            inside += d * float(motion[lag, 3, k])
            inside += e * float(motion[lag, 4, k])
            inside += f * float(motion[lag, 5, k])
            outside += not (low < inside and inside < high)
        if outside:
            break
        now += ROW_STEPS
    while now < end and low < swayed_px_kernel(edge, motion, now) < high:
        now += 1
    return now - step


@njit(cache=True, nogil=True, error_model="numpy")
def small_motion_kernel(
    pixels: NDArray[Any],
    rims: Rims,
    chip: Any,
    beds: TimingWheel,
    motion: NDArray[np.float32],
    start_us: float,
    step_us: float,
    out: NDArray[np.int64],
) -> None:
    """Render a stretch of sway; the keys of its events follow ``out[0]``, in no order.

    Args:
        pixels: ``(n,)`` of :data:`~spikingtac.sim.camera.pixels.PIXEL_DTYPE`, row by row.
        rims: Those of them that are near an edge.
        chip: Record of :data:`~spikingtac.sim.camera.pixels.CHIP_DTYPE`.
        beds: Who sleeps.
        motion: ``(lags, 6, 1 + steps)`` low-passed bushing at the beginning and after each step.
        start_us: Time of the first step's beginning.
        step_us: Length of a step.
        out: ``out[0]`` counts the events; those beyond its end are only counted.
    """
    for step in range(1, motion.shape[2]):
        times = (start_us + (step - 1) * step_us, start_us + step * step_us)
        pop_due_kernel(beds)
        kept = 0
        for n in range(beds.up[0]):
            pixel = beds.awake[n]
            place = rims.place[pixel]
            stay = 0
            asleep_us = 0.0
            if place < 0:
                asleep_us = ground_kernel(pixels[pixel], chip, times, out)
            else:
                edge = rims.edges[place]
                stay = stay_kernel(edge, motion, step, start_us, step_us)
                if stay == 0:
                    before_px = swayed_px_kernel(edge, motion, step - 1)
                    inside_px = swayed_px_kernel(edge, motion, step)
                    asleep_us = rim_kernel(
                        pixels[pixel], edge, chip, before_px, inside_px, times, out
                    )
                    stay = 1 + stay_kernel(edge, motion, step + 1, start_us, step_us)
            if asleep_us > LEAST_SLEEP_STEPS * step_us:
                schedule_kernel(beds, pixel, asleep_us / step_us)
            elif stay > 1:
                schedule_kernel(beds, pixel, float(stay))
            else:
                beds.awake[kept] = pixel
                kept += 1
        beds.up[0] = kept
        beds.turn[0] = (beds.turn[0] + 1) % beds.first.shape[0]


def lag_coefficients(lag_us: float, step_us: float) -> tuple[list[float], list[float]]:
    """Return the filter (b, a) of a first-order low-pass whose input moves evenly in each step."""
    steps = lag_us / step_us
    decay = math.exp(-1.0 / steps)
    rest = steps * (1.0 - decay)
    return [1.0 - rest, rest - decay], [1.0, -decay]
